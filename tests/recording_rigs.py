"""Sensors for tests of recording: quick, without a renderer, with the sample number as data."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, LeafSystem, State

from mirdrake.sensors.sampling import SampledValue
from mirdrake.vehicles.mounts import SENSOR_KINDS

ROWS, COLUMNS, BEAMS = 4, 30, 180


@dataclass
class Scan:
    """Scan of a counting lidar: all ranges of sample k are k, but the first is inf."""

    time: float
    ranges: np.ndarray
    beam_times: np.ndarray
    azimuths: np.ndarray
    elevations: np.ndarray


def make_scan(time: float, number: int) -> Scan:
    ranges = np.full((ROWS, COLUMNS), float(number), dtype=np.float32)
    ranges[0, 0] = np.inf
    steps = np.linspace(0.0, 0.05, COLUMNS)
    return Scan(time, ranges, steps, np.linspace(-0.4, 0.4, COLUMNS), np.linspace(-0.03, 0.3, ROWS))


class CountingLidar(LeafSystem):
    """A lidar with an abstract output."""

    record = "array"

    def __init__(self, rate: float) -> None:
        super().__init__()
        self.rate = rate
        self._held = self.DeclareAbstractState(AbstractValue.Make(make_scan(-1.0, -1)))
        self.DeclareStateOutputPort("cloud", self._held)
        self.DeclarePeriodicUnrestrictedUpdateEvent(1.0 / rate, 0.0, self._take)

    def _take(self, context: Context, state: State) -> None:
        scan = make_scan(context.get_time(), round(context.get_time() * self.rate))
        state.get_mutable_abstract_state(int(self._held)).set_value(scan)


class CountingScanner(LeafSystem):
    """A laser scanner whose beams all measure the number of the scan."""

    record = "array"

    def __init__(self, rate: float) -> None:
        super().__init__()
        self.rate = rate
        self._held = self.DeclareDiscreteState(np.full(BEAMS, -1.0))
        self.DeclareStateOutputPort("sample", self._held)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / rate, 0.0, self._take)

    def _take(self, context: Context, state: Any) -> None:
        number = round(context.get_time() * self.rate)
        state.get_mutable_vector(self._held).SetFromVector(np.full(BEAMS, float(number)))


class StillCamera(LeafSystem):
    """A camera whose pictures are grey, one level brighter each time."""

    record = "pictures"

    def __init__(self, mount: Any, *, several: bool = False) -> None:
        super().__init__()
        self.rate, self._size, self._several = mount.rate, (mount.height, mount.width), several
        self.DeclareVectorOutputPort("nothing", BasicVector(1), lambda context, output: None)
        self.DeclarePeriodicPublishEvent(1.0 / mount.rate, 0.0, lambda context: None)

    def look(self, context: Context) -> np.ndarray | Mapping[str, np.ndarray]:
        number = round(context.get_time() * self.rate)
        color = np.full((*self._size, 3), 20 + number % 200, dtype=np.uint8)
        if not self._several:
            return color
        depth = np.full(self._size, 0.5 * number, dtype=np.float32)
        depth[0, 0] = np.inf
        return {"color": color, "depth": depth, "label": np.full(self._size, number, dtype=np.int16)}


class Pictures:
    """Images of a :class:`LateCamera`."""

    def __init__(self, level: int) -> None:
        self.pictures = {"color": np.full((8, 8, 3), level, dtype=np.uint8)}


class LateCamera(SampledValue):
    """A camera whose images arrive with latency, and some of which are lost; each is one level brighter."""

    record = "pictures"

    def __init__(self, mount: Any, *, latency: float, dropout: float) -> None:
        late = mount.model_copy(update={"latency": latency, "dropout": dropout})
        super().__init__("shot", AbstractValue.Make(Pictures(0)), late, stream=7)

    def take(self, context: Context, index: int, sample: AbstractValue) -> None:
        sample.set_value(Pictures(20 + index))


def stubs(*, several: bool = False) -> dict[str, Any]:
    """Functions that make a sensor in place of the method `make` of its mount, by kind."""

    def lidar(mount: Any, **_: Any) -> LeafSystem:
        return CountingLidar(mount.rate)

    def scanner(mount: Any, **_: Any) -> LeafSystem:
        return CountingScanner(mount.rate)

    def camera(mount: Any, **_: Any) -> LeafSystem:
        return StillCamera(mount, several=several)

    return {"lidar": lidar, "laser_scanner": scanner, "camera": camera}


def install_stubs(patch: pytest.MonkeyPatch, *, several: bool = False) -> None:
    """Let mounts make stubs."""
    for kind, make in stubs(several=several).items():
        patch.setattr(SENSOR_KINDS[kind], "make", make)
