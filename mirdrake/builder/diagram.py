"""A diagram built in Python.

::

    d = mir.Diagram(world="test_track", time_step=0.005)
    ego = d.add_vehicle("bolt", start="line")
    d.drive(ego, mir.PathTracking(track="main", speed=5.0))
    notch = d.add("notch", Notch, frequency=4.0)
    d.connect(ego.driver.steering_command, notch.u)
    d.connect(notch.y, ego.control.steering_reference)
    run = d.simulate(30)
    d.to_yaml("my.yaml")

Every call writes into the data of a diagram file, which the same code checks, assembles and runs.
"""

import copy
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Diagram as DrakeDiagram
from pydrake.systems.framework import PortDataType, System

from mirdrake.assembly.diagram import Assembly, assemble, make_spec
from mirdrake.assembly.diagram_spec import DiagramSpec, parse_diagram
from mirdrake.assembly.drawing import draw_svg, fit_svg
from mirdrake.assembly.scene import load_vehicle_of
from mirdrake.builder.names import Name
from mirdrake.controllers.driver import Driver
from mirdrake.core.checks import checks_arguments
from mirdrake.core.errors import ConfigError, MirdrakeError, MissingDependencyError, did_you_mean
from mirdrake.core.files import write_file
from mirdrake.core.json_io import Json, plain_data
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.paths import find
from mirdrake.core.signals import signals_of
from mirdrake.core.yaml_io import display_path, read_text
from mirdrake.core.yaml_rewrite import rewrite
from mirdrake.core.yaml_tree import parse_tree
from mirdrake.runs.logs import Run
from mirdrake.runs.simulation import Simulation

if TYPE_CHECKING:
    from mirdrake.tuning.linearise import LinearModel

T = TypeVar("T")

INNER = ".control.**"
"""Pattern behind a vehicle's name for the signals of the blocks of its control unit."""


def _with_checked_arguments(owner: type[T]) -> type[T]:
    """Decorate a class so that wrong arguments of its public methods are errors of one line."""
    for name, member in list(vars(owner).items()):
        if inspect.isfunction(member) and (name == "__init__" or not name.startswith("_")):
            setattr(owner, name, checks_arguments(member))
    return owner


def _name_in(call: str, given: object) -> str:
    """Return the text of a name.

    Raises:
        ConfigError: it is something else, such as a port of a system.
    """
    if not isinstance(given, Name | str):
        raise ConfigError(
            f"expected a name, such as ego.vx or 'ego.vx', got {type(given).__name__}; "
            "the ports of a block are attributes of what add() returns",
            where=call,
        )
    return str(given)


@_with_checked_arguments
class Diagram:
    """A diagram built in Python: vehicles in a world, drivers, sensors and blocks, and their connections.

    Args:
        world: name of a world or path of its file; or a mapping with name, seed and params.
        time_step: step of the plant [s].
        contact: "hydroelastic" or "point".
        name: name in run folders.
        duration: simulated time [s].
        seed: of every random stream.
        plant: other keys of `plant` in a diagram file.
    """

    def __init__(
        self,
        world: str | Mapping[str, Any] = "empty",
        *,
        time_step: float | None = None,
        contact: str | None = None,
        name: str | None = None,
        duration: float | None = None,
        seed: int | None = None,
        plant: Mapping[str, Any] | None = None,
    ) -> None:
        where_world = world.get("name", "") if isinstance(world, Mapping) else world
        find("worlds", str(where_world), where="Diagram: world")
        keys = {"time_step": time_step, "contact": contact}
        numerics = dict(plant or {}) | {key: value for key, value in keys.items() if value is not None}
        self._data: Json = {"world": world, "vehicles": {}}
        self._data |= {"plant": numerics} if numerics else {}
        given = {"name": name, "duration": duration, "seed": seed}
        self._data |= {key: value for key, value in given.items() if value is not None}
        self._file: tuple[Path, str] | None = None  # that it was loaded from, with its text
        self._factories: dict[str, _Factory] = {}
        self._built: dict[tuple[str, str], Assembly] = {}

    @classmethod
    def load(cls, name: str) -> "Diagram":
        """Return the diagram of a file: a name below diagrams/, or a path.

        Raises:
            ConfigError: no such file, or it has faults.
        """
        path = find("diagrams", name)
        text = read_text(path)
        data = _data_of(text, path)
        diagram = cls(data["world"])
        diagram._data, diagram._file = data, (path, text)
        return diagram

    # --- building ------------------------------------------------------------------------------------------------

    def add_vehicle(
        self,
        model: str,
        name: str = "ego",
        *,
        start: str | Mapping[str, Any] | None = None,
        speed: float | None = None,
        **keys: Any,
    ) -> Name:
        """Add a vehicle.

        Args:
            model: name of a folder in models/, or a path; with @ and a variant behind it.
            name: its name in the diagram.
            start: a start of the world, or {x [m], y [m], yaw [rad]}; the world's first one if left out.
            speed: speed at the start [m/s].
            keys: other keys of a vehicle in a diagram file: arguments, mounts, control, parked.

        Returns:
            Its name; attributes are its ports and parts.

        Raises:
            ConfigError: the name is taken, or a key is unknown.
        """
        if name in self._data["vehicles"] or name in self._data.get("systems", {}):
            raise ConfigError(f"add_vehicle: the name '{name}' is taken; choose another: add_vehicle(model, name)")
        given = {"model": model, "start": start, "speed": speed} | keys
        entry = {key: value for key, value in given.items() if value is not None}
        return self._change(("vehicles", name), entry)

    def drive(self, vehicle: Name | str, driver: Driver | Mapping[str, Any] | str, **settings: Any) -> Name:
        """Let a driver command a vehicle.

        Args:
            vehicle: the vehicle.
            driver: a driver such as :class:`mirdrake.PathTracking`, a kind by name, or a mapping with a `kind`.
            settings: settings of a kind that is given by name.

        Returns:
            Name of the driver.

        Raises:
            ConfigError: no such vehicle or kind, or a setting is unknown or out of range.
        """
        name = self._vehicle("drive", vehicle)
        if isinstance(driver, Driver):
            # Only what was set, so that the diagram file that is written has no defaults in it.
            entry = driver.model_dump(mode="json", exclude_unset=True)
        elif isinstance(driver, str | Mapping):
            entry = ({"kind": driver} if isinstance(driver, str) else dict(driver)) | settings
        else:
            raise ConfigError(
                f"drive: a driver is a kind by name, a mapping with a kind, or an object such as mir.PathTracking(…); "
                f"got {type(driver).__name__}"
            )
        self._change(("control", name), entry)
        return self[f"{name}.driver"]

    def sensors(self, vehicle: Name | str, *names: str) -> None:
        """Use sensors of a vehicle, by the names in its sensors.yaml.

        Raises:
            ConfigError: no such vehicle.
        """
        name = self._vehicle("sensors", vehicle)
        self._change(("sensors", name), [*self._data.get("sensors", {}).get(name, ()), *names])

    def add(self, name: str, system: str | type[System] | System, **parameters: Any) -> Name:
        """Add a block.

        Args:
            name: name of the block.
            system: a kind by name ("pid", "delay", "module:Class"), a class of Drake systems, or an object of one. An
                object can be built into one diagram only; with a class the diagram can be changed and built again.
            parameters: parameters of the kind, or arguments of the class.

        Returns:
            Name of the block; attributes are its ports.

        Raises:
            ConfigError: the name is taken, the kind is unknown, or it is not a Drake system.
        """
        if name in self._data.get("systems", {}) or name in self._data["vehicles"]:
            raise ConfigError(f"add: the name '{name}' is taken; choose another")
        return self._add(name, system, parameters)

    def replace(self, block: Name | str, system: str | type[System] | System, **parameters: Any) -> Name:
        """Replace a block of a control unit, as in ``d.replace(ego.control.speed_pid, MyPid, kp=1.0)``.

        The ports of the system are those of the block by name; its only input and its only output may have any name.

        Args:
            block: name of the block.
            system: see :meth:`add`.
            parameters: see :meth:`add`.

        Raises:
            ConfigError: no such block, or the system is not a Drake system.
        """
        return self._add(_name_in("replace", block), system, parameters)

    def connect(self, source: Name | str, sink: Name | str) -> None:
        """Connect an output, or an element of it, to an input. It replaces the connection that the input has.

        Raises:
            ConfigError: the input is connected already by an earlier call.
        """
        source, sink = _name_in("connect", source), _name_in("connect", sink)
        pairs = self._data.setdefault("connect", [])
        earlier = next((pair for pair in pairs if pair[1] == sink), None)
        if earlier is not None:
            raise ConfigError(f"connect: input '{sink}' is already fed by '{earlier[0]}'; disconnect it first")
        pairs.append([source, sink])

    def disconnect(self, sink: Name | str) -> None:
        """Remove the connection to an input that :meth:`connect` made.

        Raises:
            ConfigError: there is none.
        """
        pairs = self._data.get("connect", [])
        sink = _name_in("disconnect", sink)
        remaining = [pair for pair in pairs if pair[1] != sink]
        if len(remaining) == len(pairs):
            raise ConfigError(
                f"disconnect: no call of connect has fed '{sink}'; {did_you_mean(sink, [pair[1] for pair in pairs])}"
            )
        self._data["connect"] = remaining

    def record(self, *signals: str, **keys: Any) -> None:
        """Choose what a run records.

        Args:
            signals: patterns of inner signals, as "ego.control.**".
            keys: keys of `record` in a diagram file: rate, cameras, arrays, meshcat, report.
        """
        record = dict(self._data.get("record", {})) | keys
        if signals:
            record["signals"] = list(signals)
        self._change(("record",), record)

    def stop_after(self, *, duration: float | None = None, laps: float | None = None) -> None:
        """Set when a run ends.

        Args:
            duration: simulated time [s].
            laps: laps of the first vehicle.
        """
        for key, value in (("duration", duration), ("laps", laps)):
            if value is not None:
                self._change((key,), value)

    def set(self, path: str, value: Any) -> None:
        """Set a key of the diagram file by its dotted path: ``d.set("vehicles.ego.control.speed.kp", 2.0)``.

        Raises:
            ConfigError: there is no such key, or the value is not allowed.
        """
        self._change(tuple(path.split(".")), value)

    def sliders(self, *signals: str, duration: float = 10.0, **ranges: tuple[float, float]) -> Any:
        """Return sliders for a notebook that change keys of the diagram, simulate it again and plot signals.

        Args:
            signals: patterns of the signals to plot.
            duration: simulated time [s].
            ranges: smallest and largest value of each key, by its dotted path:
                ``d.sliders("ego.vx", **{"vehicles.ego.control.speed.kp": (0, 3)})``.

        Raises:
            MissingDependencyError: ipywidgets is not installed.
            ConfigError: a range is empty.
        """
        from mirdrake.builder.sliders import make_sliders

        for path, given in ranges.items():
            if not (isinstance(given, tuple | list) and len(given) == 2):
                raise ConfigError(f"sliders: {path}: give the smallest and the largest value, such as (0, 3)")
            self._changed(tuple(path.split(".")), float(given[0]))
        present = {path: self._number_at(path) for path in ranges}
        return make_sliders(self, signals, ranges, present=present, duration=duration)

    # --- looking -------------------------------------------------------------------------------------------------

    def __getitem__(self, name: str) -> Name:
        """Return a name of the diagram: ``d["ego.control.speed_pid"]``."""
        return Name(name, self._names)

    def spec(self) -> DiagramSpec:
        """Return the checked diagram spec.

        Raises:
            ConfigError: it has faults.
        """
        named = {} if self._file is None else {"name": self._file[0].stem}
        return make_spec(named | copy.deepcopy(self._data))

    def ports(self, pattern: str = "*") -> "Any":
        """Return the ports as a table: name, direction, elements and units.

        Args:
            pattern: only ports of these names, as "ego.control.*".
        """
        from fnmatch import fnmatchcase

        import pandas as pd

        # The expanded diagram shows the ports inside the control too, as users connect to them.
        assembly = self._display(expand=True)
        rows = [
            (name, direction, ", ".join(f"{signal.name} [{signal.unit or '-'}]" for signal in contents or ()))
            for direction, ports in (("output", assembly.outputs), ("input", assembly.inputs))
            for name, contents in sorted(ports.items())
            if fnmatchcase(name, pattern)
        ]
        if not rows:
            names = [*assembly.outputs, *assembly.inputs]
            raise ConfigError(f"ports: no port matches '{pattern}'; {did_you_mean(pattern, names)}")
        return pd.DataFrame(rows, columns=["port", "direction", "elements"]).set_index("port")

    def draw(self, *expand: Name | str) -> "Drawing":
        """Return the block diagram as a picture.

        Args:
            expand: systems whose blocks are drawn, such as ``ego.control``.

        Raises:
            MissingDependencyError: Graphviz is not installed.
        """
        return Drawing(draw_svg(self._display(expand=bool(expand)), expand=[str(name) for name in expand]))

    def _repr_svg_(self) -> str | None:
        """Return the block diagram, for a notebook; None if it cannot be drawn."""
        try:
            return fit_svg(draw_svg(self._display(expand=False)))
        except (MissingDependencyError, MirdrakeError):
            return None

    def __repr__(self) -> str:
        """Return vehicles, drivers, sensors, blocks and connections, one line each."""
        data = self._data
        world = data["world"] if isinstance(data["world"], str) else data["world"].get("name")
        lines = [f"Diagram in the world {world}"]
        for name, entry in data["vehicles"].items():
            driver = data.get("control", {}).get(name)
            kind = driver if isinstance(driver, str) else (driver or {}).get("kind", "nobody")
            sensors = ", ".join(data.get("sensors", {}).get(name, ()))
            # The text has no values: cells of a notebook show it after each step, and it is to fit on a screen.
            lines.append(f"  {name}: {entry['model']}, driven by {kind}" + (f", sensors {sensors}" if sensors else ""))
        lines += [f"  {name}: {entry['kind']}" for name, entry in data.get("systems", {}).items()]
        lines += [f"  {source} -> {sink}" for source, sink in data.get("connect", ())]
        return "\n".join(lines)

    # --- using ---------------------------------------------------------------------------------------------------

    def assemble(self, *, meshcat: Meshcat | None = None, expand: bool = False) -> Assembly:
        """Return the assembled diagram; see :func:`mirdrake.assembly.diagram.assemble`."""
        return self._assemble(self.spec(), meshcat=meshcat, expand=expand)

    def build(self, *, meshcat: Meshcat | None = None) -> DrakeDiagram:
        """Return an ordinary Drake Diagram; see :func:`mirdrake.make_diagram`."""
        return self._assemble(self.spec(), meshcat=meshcat, expand=True, continuous=False).diagram

    def simulate(
        self,
        duration: float | None = None,
        *,
        folder: Path | str | None = None,
        meshcat: Meshcat | None = None,
        inner: bool = True,
        **options: Any,
    ) -> Run:
        """Simulate the diagram once.

        Args:
            duration: simulated time [s]; that of the diagram if left out.
            folder: run folder to write; None keeps the run in memory.
            meshcat: shows the run while it goes on.
            inner: whether to record the signals of the blocks of all control units. Without them the control units run
                as one compiled system, which is faster and gives the same bits.
            options: see :func:`mirdrake.simulate`.

        Raises:
            ConfigError, ModelError, WorldError, DiagramError: the diagram cannot be built.
            RunError: the folder cannot be written, or a block raised an exception.
        """
        spec = self.spec()
        if inner and spec.record.signals is True:
            spec.record.signals = [f"{name}{INNER}" for name in spec.vehicles]
        # Assembling takes longer than many runs, so that a diagram that has not changed is assembled once.
        key = (repr(self._data), repr(spec.record))
        if meshcat is None and key in self._built:
            assembly = self._built[key]
        else:
            assembly = self._assemble(spec, meshcat=meshcat, expand=False)
            self._built = {key: assembly}
        return Simulation(assembly).run(duration=duration, folder=folder, **options)

    def linearize(
        self,
        input: Name | str,  # noqa: A002
        output: Name | str | None = None,
        *,
        time: float = 5.0,
        cut: bool = True,
    ) -> "LinearModel":
        """Return a linear model between an input and an output around an operating point, for python-control.

        Without an output it is that of the whole loop through the input: ``d.linearize(ego.control.wheel_speeds
        .correction).margins()`` are the margins of the speed loop.

        Args:
            input: an input with one element, or an element of one.
            output: an output or an element of one; the source of the input if left out.
            time: time at which the operating point is read [s]; the vehicle should be in a steady state then.
            cut: whether the connection to the input is cut (open loop). False: a disturbance at the input, with all
                loops closed.

        Raises:
            ConfigError: no such port, or the input has no source.
            MissingDependencyError: python-control is not installed.
        """
        from mirdrake.tuning.linearise import linearise

        sink, name = _name_in("linearize", input), None if output is None else _name_in("linearize", output)
        assembly = self._display(expand=True)
        parts = [f"{port}.{own.name}" for port, contents in assembly.inputs.items() for own in contents or ()]
        if sink not in {*assembly.inputs, *parts, *assembly.aliases}:
            raise ConfigError(f"linearize: unknown input '{sink}'; {did_you_mean(sink, assembly.inputs)}")
        elements = assembly.inputs.get(sink) or ()
        if len(elements) > 1:
            raise ConfigError(
                f"linearize: input '{sink}' has {len(elements)} elements; name one of them: {sink}.{elements[0].name}"
            )
        return linearise(self._data, self._factories, sink, name, time=time, cut=cut)

    def to_yaml(self, path: Path | str | None = None) -> str:
        """Return the diagram as the text of a diagram file, and write it if a path is given.

        A diagram that was loaded keeps the text of its file, with comments and units; only what was changed differs.

        Args:
            path: file to write, relative to which the text names files.

        Raises:
            ConfigError: a block is an object, or of a class that no module has, and cannot be written.
        """
        # Checked first: a file must not replace a good one and then be rejected when it is loaded.
        self.spec()
        for name, factory in self._factories.items():
            if factory.unwritable:
                raise ConfigError(f"to_yaml: block '{name}' cannot be written: {factory.unwritable}")
        data = plain_data(self._data)
        text = self._edited(data, None if path is None else Path(path))
        if text is None:
            text = rewrite("", {}, data)
        if path is not None:
            write_file(Path(path), text)
        return text

    # --- inside --------------------------------------------------------------------------------------------------

    def _edited(self, data: Json, path: Path | None) -> str | None:
        """Return the text of the diagram's file with the changes; None if there is no file, or it cannot have them."""
        if self._file is None:
            return None
        own, text = self._file
        target = own if path is None else path.resolve()
        try:
            # The user's own file keeps its comments and order if the changes can be made in it and it then means the
            # same.
            text = rewrite(text, _data_of(text, target), data, name=display_path(target))
            written = _data_of(text, target)
            same = make_spec(written).model_dump() == make_spec(copy.deepcopy(data)).model_dump()
        except ConfigError:
            return None
        return text if same else None

    def _change(self, path: tuple[str, ...], value: Any) -> Name:
        """Set a part of the data, if the diagram stays valid."""
        self._data = self._changed(path, value)
        return self[path[-1]]

    def _changed(self, path: tuple[str, ...], value: Any) -> Json:
        """Return the data with a changed part.

        Raises:
            ConfigError: there is no such key, or the value is not allowed.
        """
        data = copy.deepcopy(self._data)
        part = data
        for key in path[:-1]:
            part = part.setdefault(key, {}) if isinstance(part, dict) else {}
        if not isinstance(part, dict):
            raise ConfigError(f"there is no such key; {'.'.join(path[:-1])} is {part!r}", where=".".join(path))
        part[path[-1]] = value
        spec = make_spec(copy.deepcopy(data))
        if path[0] == "vehicles":
            load_vehicle_of(spec, path[1])  # its control.yaml with the changed entries
        return data

    def _number_at(self, path: str) -> float | None:
        """Return the number of a key by its dotted path: that of the diagram, or of control.yaml; None without one."""
        part: Any = self._data
        keys = path.split(".")
        for key in keys:
            part = part.get(key) if isinstance(part, Mapping) else None
        # A gain that the diagram does not change has the value of the vehicle's own control.
        if part is None and keys[0] == "vehicles" and keys[2:3] == ["control"]:
            part = load_vehicle_of(self.spec(), keys[1]).control
            for key in keys[3:]:
                part = getattr(part, key, None)
        return float(part) if isinstance(part, int | float) and not isinstance(part, bool) else None

    def _vehicle(self, call: str, vehicle: Name | str) -> str:
        name, known = str(vehicle), self._data["vehicles"]
        if name not in known:
            raise ConfigError(f"no vehicle '{name}'; {did_you_mean(name, known)}", where=call)
        return name

    def _add(self, name: str, system: str | type[System] | System, parameters: Mapping[str, Any]) -> Name:
        # Parameters of a class of this session, or its code after its cell was run again, are not in the data that a
        # built diagram is kept for.
        self._built.clear()
        # The name of a kind is written to the file. For an object or a class a factory is kept as well: the file cannot
        # contain it.
        if isinstance(system, str):
            self._factories.pop(name, None)
            self._change(("systems", name), {"kind": system, **parameters})
            return self[name]
        factory = _Factory(name, system, parameters)
        self._change(("systems", name), {"kind": factory.kind, **(parameters if not factory.unwritable else {})})
        self._factories[name] = factory
        return self[name]

    def _assemble(
        self, spec: DiagramSpec, *, meshcat: Meshcat | None, expand: bool, continuous: bool = True
    ) -> Assembly:
        return assemble(spec, meshcat=meshcat, expand=expand, factories=self._factories, continuous=continuous)

    def _display(self, *, expand: bool) -> Assembly:
        """Return the diagram with copies of the ports in place of objects, which stay free to be built in."""
        key = (repr(self._data), f"display {expand}")
        if key not in self._built:
            factories: dict[str, Callable[[], System]] = {
                name: factory.make_display for name, factory in self._factories.items()
            }
            self._built[key] = assemble(self.spec(), expand=expand, factories=factories)
        return self._built[key]

    def _names(self) -> list[str]:
        try:
            assembly = self._display(expand=True)
        except MirdrakeError:
            return []
        ports = [*assembly.outputs.items(), *assembly.inputs.items()]
        elements = [f"{name}.{own.name}" for name, contents in ports for own in contents or ()]
        return [*(name for name, _ in ports), *elements, *assembly.aliases]


class Drawing:
    """A picture of a block diagram, which a notebook shows; ``str(drawing)`` is its SVG text."""

    def __init__(self, svg: str) -> None:
        self._svg = svg

    def _repr_svg_(self) -> str:
        return fit_svg(self._svg)

    def __str__(self) -> str:
        """Return the SVG text."""
        return self._svg


class _Factory:
    """Maker of a block from a class or an object.

    Attributes:
        kind: name of the class as ``module:Class``.
        unwritable: why a diagram file cannot name it; empty: it can.
    """

    def __init__(self, name: str, system: type[System] | System, parameters: Mapping[str, Any]) -> None:
        own = system if isinstance(system, type) else type(system)
        if not issubclass(own, System):
            raise ConfigError(
                f"add: '{name}' is {own.__name__}, which is not a Drake system; give a class, an object or a kind"
            )
        if parameters and not isinstance(system, type):
            raise ConfigError(
                f"add: '{name}' is an object; give its arguments to the class: add(name, {own.__name__}, …)"
            )
        self.kind = f"{own.__module__}:{own.__qualname__}"
        self.unwritable = ""
        if own is not system:
            self.unwritable = f"it is an object; write add('{name}', {own.__name__}, <arguments>)"
        elif own.__module__ == "__main__" or "<locals>" in own.__qualname__:
            # A class of a notebook cell cannot be imported when the YAML file is read.
            self.unwritable = (
                f"{own.__name__} is defined in this session; move the class to a file module.py beside the YAML"
            )
        self._name, self._system, self._parameters, self._is_used = name, system, dict(parameters), False

    def __call__(self) -> System:
        """Return the system.

        Raises:
            ConfigError: it is an object that was built in already.
        """
        if isinstance(self._system, type):
            return self._system(**self._parameters)
        # Drake lets a system be part of one diagram only.
        if self._is_used:
            raise ConfigError(
                f"'{self._name}' is an object and already part of a built diagram; give the class, so that the diagram "
                f"can be built again: add('{self._name}', {type(self._system).__name__}, <arguments>)"
            )
        self._is_used = True
        return self._system

    def make_display(self) -> System:
        """Return the system, or for an object a system with the same ports."""
        if isinstance(self._system, type):
            return self._system(**self._parameters)
        return type(type(self._system).__name__, (_Ports,), {})(self._system)


class _Ports(LeafSystem):  # type: ignore[misc, unused-ignore]
    """A system with the ports of another one, to draw and to check a diagram without building the other into it."""

    def __init__(self, system: System) -> None:
        super().__init__()
        book = {}
        for index in range(system.num_input_ports()):
            # Ports have the names, sizes and units of those of the system, but no function of their own.
            port = system.get_input_port(index)
            if port.get_data_type() == PortDataType.kVectorValued:
                self.DeclareVectorInputPort(port.get_name(), port.size())
            else:
                self.DeclareAbstractInputPort(port.get_name(), system.AllocateInputAbstract(port))
            book["input", port.get_name()] = signals_of(port)
        for index in range(system.num_output_ports()):
            output = system.get_output_port(index)
            if output.get_data_type() == PortDataType.kVectorValued:
                self.DeclareVectorOutputPort(output.get_name(), output.size(), self._calc, {self.nothing_ticket()})
            else:
                self.DeclareAbstractOutputPort(output.get_name(), output.Allocate, self._calc, {self.nothing_ticket()})
            book["output", output.get_name()] = signals_of(output)
        self._mirdrake_signals = {key: contents for key, contents in book.items() if contents is not None}

    def _calc(self, context: Any, output: Any) -> None:
        """Leave the output as allocated: nothing reads it."""


def _data_of(text: str, path: Path) -> Json:
    """Return the data of a diagram file in SI units, with the paths that its text means; without a name of the file's.

    Raises:
        ConfigError: the text has faults.
    """
    data = parse_diagram(text, path).model_dump(mode="json", exclude_unset=True)
    if "name" not in parse_tree(text, display_path(path))[0]:
        del data["name"]
    return data
