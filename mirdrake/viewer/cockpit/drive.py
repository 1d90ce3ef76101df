"""A manual drive in real time.

The loop runs in one thread and owns the simulation. Pages send input to :attr:`Cockpit.watchdog` and requests to
:meth:`Cockpit.order`, from threads of a server; requests are executed between two time slices.
"""

import queue
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, EventStatus

from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import DiagramSpec
from mirdrake.assembly.parts.taps import Tap, clear_logs
from mirdrake.assembly.scene import Scene
from mirdrake.controllers.runtime_gains import get_gain, set_gain
from mirdrake.core.errors import ConfigError, RunError, first_line
from mirdrake.plant.wheels import RoadFriction
from mirdrake.runs.logs import Run
from mirdrake.runs.simulation import default_folder
from mirdrake.viewer.cockpit.driver import HumanDriver
from mirdrake.viewer.cockpit.log import DriveLog
from mirdrake.viewer.cockpit.manual import STANDING, ManualCommand, command_step, stop_step
from mirdrake.viewer.cockpit.overlays import Overlays
from mirdrake.viewer.cockpit.pace import FRAME, Pace
from mirdrake.viewer.cockpit.picture import Picture
from mirdrake.viewer.cockpit.start import NAME, manual_limits
from mirdrake.viewer.cockpit.watchdog import TIMEOUT, InputWatchdog
from mirdrake.viewer.meshcat import meshcat_faults
from mirdrake.worlds import Track

SLICE = 1.0 / 64.0
"""Approximate simulated time between two readings of the input [s]; it is a multiple of the step of the plant."""

BLOCK = 0.25
"""Simulated time between two readings of the logs [s]."""


def follow_track(track: Track, x: float, y: float, last: float | None) -> tuple[float, float]:
    """Return the place on a track that is nearest to a point, near the last place until another is clearly nearer.

    Where two parts of a track are equally near, the nearest place would alternate between them.

    Args:
        track: the track.
        x: world x [m].
        y: world y [m].
        last: the last place [m]; None at the start.

    Returns:
        s [m], and the lateral distance e_y to the centre line there [m], + left.
    """
    nearest = track.project(x, y)
    if last is None:
        return nearest
    kept = track.project(x, y, near=last)
    # Half a road width is more than the noise of a standing vehicle and less than the distance of two roads.
    return kept if abs(kept[1]) < abs(nearest[1]) + 0.5 * track.width else nearest


class Cockpit:
    """A drive in real time.

    Args:
        spec: result of :func:`drive_spec`.
        scene: scene of the spec, if it is made already.
        meshcat: Meshcat instance in which to draw, made in the thread that drives; None draws nothing.
        print_line: prints a message of one line.
        folder: returns the folder of a recording.
        timeout: see :class:`~mirdrake.viewer.cockpit.watchdog.InputWatchdog`.

    Attributes:
        watchdog: input of the driver.
        readings: readings of the gauges, as JSON data; replaced, never changed.
        runs: recorded runs.

    Raises:
        ConfigError, ModelError, WorldError, DiagramError: the diagram cannot be built.
    """

    def __init__(
        self,
        spec: DiagramSpec,
        *,
        scene: Scene | None = None,
        meshcat: Meshcat | None = None,
        print_line: Callable[[str], None] = lambda _: None,
        folder: Callable[[], Path] | None = None,
        timeout: float = TIMEOUT,
    ) -> None:
        self.assembly = assemble(spec, scene=scene, drawn=meshcat is not None)
        self.part = self.assembly.parts.vehicles[NAME]
        self.limits = manual_limits(self.part)
        self.gains = self.part.vehicle.control.gains()
        self.watchdog = InputWatchdog(timeout=timeout)
        self.readings: Mapping[str, Any] = {}
        self.runs: list[Run] = []
        self._print_line, self._folder = (
            print_line,
            folder or (lambda: default_folder(f"drive_{self.part.vehicle.name}")),
        )
        # Ports of the blocks are read in the loop, so that their systems are looked up once.
        systems = {system.get_name(): system for system in self.assembly.diagram.GetSystems()}
        driver = systems[f"{NAME}.driver"]
        assert isinstance(driver, HumanDriver)
        self._driver, self._truth, self._control = driver, systems[f"{NAME}.truth"], systems[f"{NAME}.control"]
        self._track = self.assembly.parts.world.tracks.get(self.assembly.tracks[NAME] or "")
        self._progress: float | None = None
        self._simulator = self.assembly.make_simulator()
        self._friction = RoadFriction(self.assembly.parts, self.assembly.tyres)
        self._simulator.set_monitor(self._watch)
        self._meshcat = meshcat
        self.picture = Picture(meshcat, self.assembly, NAME) if meshcat is not None else None
        self.overlays = Overlays(meshcat, self.assembly, NAME) if meshcat is not None else None
        self._orders: queue.SimpleQueue[Mapping[str, Any]] = queue.SimpleQueue()
        # Gains are kept here, because each new Context begins with those of control.yaml.
        self._values = {gain.path: gain.value for gain in self.gains}
        self._log: DriveLog | None = None
        self._hand, self._paused, self._lost, self._over = ManualCommand(), False, False, threading.Event()
        self._alarm = False
        self._message = ""
        self._odometer, self._rates = 0.0, deque[tuple[float, float]]()
        # Only signals that the user chose for plotting are sent to the page.
        self._plotted = [tap for tap in self.assembly.taps.values() if tap.is_chosen]
        self._steps = self.assembly.steps_in(SLICE)
        self._slice = self._steps * self.assembly.spec.plant.time_step
        self._pace = Pace(self._slice)
        self._factor = 1.0
        self._begin(self.assembly.make_context())

    @property
    def signals(self) -> list[tuple[str, str]]:
        """Names and units of the inner signals that the page can plot; record.signals of the diagram chooses them."""
        return [(own.name, own.unit) for tap in self._plotted for own in tap.contents or ()]

    # --- from other threads --------------------------------------------------------------------------------------

    def order(self, request: Mapping[str, Any]) -> None:
        """Request an action: {"do": "reset" | "pause" | "record" | "gain" | "layer", ...}."""
        self._orders.put(request)

    def stop(self) -> None:
        """End :meth:`run` soon."""
        self._over.set()

    # --- the loop ------------------------------------------------------------------------------------------------

    def run(self, *, duration: float = inf, watch: Callable[[], None] | None = None) -> None:
        """Drive until :meth:`stop` or Ctrl-C, or for a duration; a recording is finished.

        Args:
            duration: wall-clock time [s].
            watch: called about once per picture.
        """
        with _interrupt(self._over):
            try:
                self._loop(time.monotonic() + duration, watch)
            finally:
                if self._log is not None:
                    self._record_off("the drive ended")

    def _loop(self, end: float, watch: Callable[[], None] | None) -> None:
        pace, measured, number = self._pace, -inf, 0
        pace.rest()
        while not self._over.is_set() and time.monotonic() < end:
            self._execute_orders()
            if self._paused:
                # A paused drive still executes orders and answers the page.
                time.sleep(0.02)
                pace.rest()
                self._rates.clear()
            else:
                self._advance()
                pace.keep()
            # Gauges have their own rate, independent of slices and pictures.
            now = time.monotonic()
            if now - measured >= FRAME:
                measured = now
                self._measure(now)
                if watch is not None:
                    watch()
            if pace.draws():
                number += 1
                # Overlays with every second picture only, to save time.
                self._draw(pace.passed, overlays=number % 2 == 0)
                pace.drew()

    def _advance(self) -> None:
        """Simulate one time slice."""
        context = self._context
        state = self._state()
        manual = self.watchdog.read()
        # Without input the watchdog returns None: the vehicle brakes instead of keeping its command.
        if manual is None:
            self._hand = stop_step(self._hand, period=self._slice, limits=self.limits)
        else:
            self._hand = command_step(self._hand, manual, measured=state[6], period=self._slice, limits=self.limits)
        self._check_input(self.watchdog.lost, moving=abs(state[6]) > STANDING or self._hand.speed != 0.0)
        self._driver.set_command(self._hand.speed, self._hand.steering)
        self._count += 1
        try:
            # A multiple of the step, so that times do not accumulate rounding errors.
            self._simulator.AdvanceTo(self._count * self._steps * self.assembly.spec.plant.time_step)
        except RunError:
            raise
        except RuntimeError as error:
            self._fail(first_line(error))
            return
        if not np.all(np.isfinite(self._plant_state())):
            self._fail("a position or velocity is not a number")
            return
        self._odometer += abs(state[6]) * self._slice
        if self.overlays is not None:
            self.overlays.note(state[0], state[1])
        # Logs are cleared even without a recording, or they would grow as long as somebody drives.
        if self._count % max(round(BLOCK / self._slice), 1) == 0:
            if self._log is not None:
                self._log.read(context)
            else:
                clear_logs(self.assembly.taps.values(), context)

    def _check_input(self, lost: bool, *, moving: bool) -> None:
        """Report that the input was lost while the vehicle moves, and that it is restored."""
        if lost and not self._lost and moving:
            self._alarm = True
            self._report("input lost: braking to standstill; press a key in the page to continue", "input")
        elif self._lost and not lost and self._alarm:
            self._alarm = False
            self._report("input restored", "input")
        self._lost = lost

    def _watch(self, context: Context) -> EventStatus:
        if self._friction.varies:
            self._friction.watch(context)
        if self._log is not None:
            self._log.watch(context)
        return EventStatus.DidNothing()

    def _fail(self, why: str) -> None:
        if self._log is not None:
            self._record_off(f"failed: {why}")
        self._report(f"the simulation failed ({why}); reset to the start", "failure")
        self._reset()

    # --- orders --------------------------------------------------------------------------------------------------

    def _execute_orders(self) -> None:
        # Orders come from other threads; here they are executed between two slices, where the Context is consistent.
        while not self._orders.empty():
            order = self._orders.get()
            action = order.get("do")
            if action == "reset":
                self._reset()
            elif action == "pause":
                self._paused = not self._paused
            elif action == "record":
                self._record_off("stopped") if self._log is not None else self._record_on()
            elif action == "gain":
                self._set_gain(order.get("name"), order.get("value"))
            elif action == "layer" and self.overlays is not None:
                with self._drawing():
                    self.overlays.switch(str(order.get("name")), order.get("on") is True)

    def _reset(self) -> None:
        """Return to the start; gains are kept."""
        if self._log is not None:
            self._record_off("reset")
        self._odometer, self._hand = 0.0, ManualCommand()
        self.watchdog.release()
        self._begin(self.assembly.make_context())
        if self.overlays is not None:
            with self._drawing():
                self.overlays.forget()
        if self.picture is not None:
            self.picture.forget()

    def _begin(self, context: Context) -> None:
        """Continue with another Context, at its time 0."""
        self._context, self._count = context, 0
        for gain in self.gains:
            set_gain(self._control, context, gain, self._values[gain.path])
        # After the Context is set: friction is looked up again at the new position.
        self._friction.start()
        self._simulator.reset_context(context)
        self._simulator.Initialize()
        self._rates.clear()
        self._pace.rest()

    def _set_gain(self, name: Any, value: Any) -> None:
        chosen = [gain for gain in self.gains if gain.path == name]
        if not chosen or isinstance(value, bool) or not isinstance(value, int | float):
            return
        # The value comes from a browser.
        if not (isfinite(value) and 0.0 <= value <= 1e9):
            return
        self._values[chosen[0].path] = float(value)
        set_gain(self._control, self._context, chosen[0], float(value))
        if self._log is not None:
            self._log.add(self._context.get_time(), "gain", f"{name} = {value:g}")

    def _changed(self) -> dict[str, float]:
        """Return the gains that were changed, by path."""
        return {gain.path: self._values[gain.path] for gain in self.gains if self._values[gain.path] != gain.value}

    def _record_on(self) -> None:
        """Start a run folder; the time restarts at 0, the vehicle keeps its state."""
        # A new Context: the state of the plant is kept, the states of controllers and sensors begin anew.
        context = self.assembly.make_context()
        plant = self.assembly.parts.plant
        plant.SetPositionsAndVelocities(plant.GetMyMutableContextFromRoot(context), self._plant_state())
        try:
            self._log = DriveLog(self.assembly, self._folder(), context, name=NAME, gains=self._changed())
        except RunError as error:
            self._report(str(error), "recording")
            return
        for path, value in self._values.items():
            self._log.add(0.0, "gain", f"{path} = {value:g}")
        self._begin(context)
        self._report(f"recording into {self._log.folder}", "recording")

    def _record_off(self, reason: str) -> None:
        assert self._log is not None
        # Cleared first, so that a failure here cannot try to finish the recording a second time.
        log, self._log = self._log, None
        try:
            self.runs.append(log.finish(self._context, reason=reason))
            self._report(f"recorded {self._context.get_time():.1f} s: mirdrake replay {log.folder}", "recording")
        except RunError as error:
            self._report(str(error), "recording")
        self._pace.rest()

    # --- readings and drawing ------------------------------------------------------------------------------------

    def _state(self) -> Any:
        return self._truth.GetOutputPort("state").Eval(self._truth.GetMyContextFromRoot(self._context)).tolist()

    def _plant_state(self) -> Any:
        plant = self.assembly.parts.plant
        return plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(self._context))

    def _report(self, text: str, kind: str) -> None:
        self._message = text
        self._print_line(text)
        if self._log is not None and kind != "recording":
            self._log.add(self._context.get_time(), kind, text)

    def _measure(self, now: float) -> None:
        """Update the readings of the gauges."""
        time = self._context.get_time()
        # After a reset, simulated time jumps back.
        if self._rates and time < self._rates[-1][1]:
            self._rates.clear()
        self._rates.append((now, time))
        while now - self._rates[0][0] > 1.0:
            self._rates.popleft()
        (since, before) = self._rates[0]
        # A shorter window would make the factor jump with every slice.
        if now - since > 0.3:
            self._factor = (time - before) / (now - since)
        # All values in SI; the page converts units.
        x = self._state()
        status = self._control.GetOutputPort("status").Eval(self._control.GetMyContextFromRoot(self._context)).tolist()
        readings: dict[str, object] = {
            "time": time,
            "x": x[0],
            "y": x[1],
            "yaw": x[5],
            "speed": x[6],
            "speed_command": self._hand.speed,
            "setpoint": status[0],
            "steering": status[1],
            "steering_command": self._hand.steering,
            "lateral": None,
            "progress": None,
            "distance": self._odometer,
            "factor": None if self._paused else self._factor,
            "paused": self._paused,
            "lost": self._lost,
            "alarm": self._alarm,
            "recording": str(self._log.folder) if self._log is not None else None,
            "message": self._message,
            "gains": dict(self._values),
            "layers": sorted(self.overlays.shown) if self.overlays is not None else [],
            # JSON has no NaN or infinity.
            "signals": [value if isfinite(value) else None for tap in self._plotted for value in self._inner(tap)],
        }
        if self._track is not None:
            self._progress, readings["lateral"] = follow_track(self._track, x[0], x[1], self._progress)
            readings["progress"] = self._progress
        self.readings = readings

    def _inner(self, tap: Tap) -> list[float]:
        """Return the present values of the elements of a tap."""
        values: list[float] = tap.value(self._context).tolist()
        return values

    @contextmanager
    def _drawing(self) -> Iterator[None]:
        """Remove the picture if Meshcat ends inside; the drive continues without it."""
        try:
            with meshcat_faults():
                yield
        except RunError as error:
            self._meshcat = self.picture = self.overlays = None
            self._report(f"{error}; the drive continues without a picture", "view")

    def _draw(self, passed: float, *, overlays: bool) -> None:
        with self._drawing():
            self._draw_all(passed, overlays=overlays)

    def _draw_all(self, passed: float, *, overlays: bool) -> None:
        if self.picture is None or self.overlays is None or self._meshcat is None:
            return
        if self.watchdog.view is not None:
            self.picture.look(self.watchdog.view)
        # Without a browser, nothing is drawn.
        if self._meshcat.GetNumActiveConnections() == 0:
            return
        # Limited, so that the camera does not jump after a long gap.
        self.picture.draw(self._context, passed=min(passed, 0.5))
        if overlays:
            self.overlays.draw(self._context)

    def gain(self, name: str) -> float:
        """Return the value of a gain in the Context.

        Raises:
            ConfigError: the gain is unknown.
        """
        for gain in self.gains:
            if gain.path == name:
                return get_gain(self._control, self._context, gain)
        raise ConfigError(f"no gain '{name}'; there are: {', '.join(gain.path for gain in self.gains)}")


@contextmanager
def _interrupt(over: threading.Event) -> Iterator[None]:
    """Have Ctrl-C set the event; a second one raises KeyboardInterrupt. Other threads than the main one ignore it."""
    # Python allows signal handlers in the main thread only.
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, frame: Any) -> None:
        if over.is_set():
            signal.default_int_handler(number, frame)
        over.set()

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
