"""Diagrams with systems written in Python are freed when nothing uses them any more."""

import gc
import importlib
import shutil
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, System
from pydrake.systems.framework import LeafSystem as DrakeLeafSystem

import mirdrake
import mirdrake.gym  # here, as Gymnasium sets an environment variable when it is imported
from mirdrake.assembly.diagram import assemble
from mirdrake.core.leaf_system import FreeableType, LeafSystem, declare_cached_value
from mirdrake.core.paths import find
from mirdrake.runs.simulation import simulate
from mirdrake.single_track.vehicle import make_single_track_vehicle
from mirdrake.vehicles import load_vehicle
from tests.marks import mostly_slow

_RANGE = {"near": 1.0, "far": 50.0}
MOUNTS: dict[str, dict[str, Any]] = {
    "camera": {"frame": "front_camera", "horizontal_fov": 1.0},
    "depth_camera": {"frame": "front_camera", "horizontal_fov": 1.0, "depth_near": 1.0, "depth_far": 50.0},
    "stereo_camera": {"frame": "front_camera", "horizontal_fov": 1.0, "baseline": 0.2},
    "gps": {"frame": "gps"},
    "imu": {"frame": "imu"},
    "ground_truth": {"frame": "imu"},
    "laser_scanner": {"frame": "front_lidar", "beams": 5, "start_angle": -0.5, "end_angle": 0.5, **_RANGE},
    "lidar": {
        "frame": "roof_lidar",
        "columns": 6,
        "rows": 2,
        "horizontal_start": -0.5,
        "horizontal_end": 0.5,
        "vertical_start": -0.1,
        "vertical_end": 0.1,
        **_RANGE,
    },
    "radar": {"frame": "front_lidar", "horizontal_fov": 0.5, "vertical_fov": 0.1, **_RANGE},
    "sonar": {"frame": "front_lidar", "cone": 0.3, **_RANGE},
    "steering_angle": {"frame": "imu"},
    "wheel_encoder": {"frame": "front_left_wheel", "counts": 64},
}
DRIVERS: dict[str, dict[str, Any]] = {
    "path_tracking": {},
    "constant": {},
    "schedule": {"rows": [{"time": 0.0, "speed": 1.0, "steering": 0.0}]},
    "straight_and_avoid": {},
    "drive_to_nearest_and_stop": {},
    "obstacle_stopper": {},
    "follow_path": {},
    "hold_lane": {},
    "blind": {},
}


def _systems(diagram: Diagram) -> Iterator[System]:
    for system in diagram.GetSystems():
        yield system
        if isinstance(system, Diagram):
            yield from _systems(system)


def _left(make: Callable[[], Diagram]) -> list[str]:
    """Return names of the systems that remain after the diagram was run and deleted."""
    diagram = make()
    alive = {system.get_name(): weakref.ref(system) for system in _systems(diagram)}
    alive["the diagram"] = weakref.ref(diagram)
    context = diagram.CreateDefaultContext()
    for index in range(diagram.num_input_ports()):
        port = diagram.get_input_port(index)
        port.FixValue(context, [0.0] * port.size())
    simulator = Simulator(diagram, context)
    simulator.AdvanceTo(0.05)
    del diagram, simulator, context
    port = None
    gc.collect()
    return [name for name, reference in alive.items() if reference() is not None]


class _Everything(LeafSystem):  # type: ignore[misc, unused-ignore]
    """A system with all kinds of callbacks, which keeps its ports and the plant."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: set[str] = set()
        self.u = self.DeclareVectorInputPort("u", 1)
        self.y = self.DeclareVectorOutputPort("y", 1, self._calc)
        self.z = self.DeclareAbstractOutputPort("z", AbstractValue.Make("").Clone, self._calc_value)
        self.value = declare_cached_value(self, "value", lambda: AbstractValue.Make(object()), self._calc_value)
        self.DeclareDiscreteState(1)
        self.DeclarePeriodicDiscreteUpdateEvent(0.01, 0.0, self._update)
        self.DeclarePeriodicUnrestrictedUpdateEvent(0.01, 0.0, self._update)
        self.DeclarePeriodicPublishEvent(0.01, 0.0, self._publish)
        self.DeclarePerStepPublishEvent(self._publish)
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclareForcedPublishEvent(self._publish)

    def _calc(self, context: Context, output: BasicVector) -> None:
        self.calls.add("calc")
        output[0] = len(self.value.evaluate(context))

    def _calc_value(self, context: Context, value: AbstractValue) -> None:
        self.calls.add("value")
        value.set_value("one")

    def _update(self, context: Context, state: Any) -> None:
        self.calls.add("update")

    def _publish(self, context: Context) -> None:
        self.calls.add("publish")
        self.y.Eval(context)


class _Derived(_Everything):  # type: ignore[misc, unused-ignore]
    """A class below another: it must not get a dictionary of its own, either."""


@pytest.mark.parametrize("kind", [_Everything, _Derived])
def test_a_system_with_every_kind_of_callback_is_called_and_freed(kind: type) -> None:
    calls: list[set[str]] = []

    def make() -> Diagram:
        builder = DiagramBuilder()
        system = builder.AddSystem(kind())
        builder.ExportInput(system.u, "u")
        calls.append(system.calls)
        diagram = builder.Build()
        system.diagram_it_is_part_of = diagram
        return diagram

    assert _left(make) == []
    assert calls == [{"calc", "value", "update", "publish"}]


def test_a_system_alone_keeps_its_diagram_alive() -> None:
    builder = DiagramBuilder()
    system = builder.AddSystem(_Everything())
    builder.ExportInput(system.u, "u")
    diagram = builder.Build()
    alive = weakref.ref(diagram)
    del builder, diagram
    gc.collect()
    assert alive() is not None  # as in pydrake: who holds a system may use the diagram
    assert system.get_name()


def test_all_our_systems_can_be_freed() -> None:
    package = Path(mirdrake.__file__).parent
    for path in package.rglob("*.py"):
        if any(word in path.read_text(encoding="utf-8") for word in ("(LeafSystem", "(Diagram", "LeafSystem_[")):
            importlib.import_module(".".join(("mirdrake", *path.relative_to(package).with_suffix("").parts)))
    classes, todo = set(), [DrakeLeafSystem, Diagram]
    while todo:
        kinds = todo.pop().__subclasses__()
        todo += kinds
        classes |= {kind for kind in kinds if kind.__module__.startswith("mirdrake.")}
    assert len(classes) > 20
    assert [kind for kind in classes if not isinstance(kind, FreeableType)] == []


@pytest.mark.parametrize("name", sorted(path.stem for path in Path("diagrams").glob("*.yaml")))
def test_a_shipped_diagram_is_freed(name: str) -> None:
    assert _left(lambda: assemble(name).diagram) == []


def test_a_diagram_with_tyres_that_touch_the_ground_themselves_is_freed() -> None:
    spec = {"world": "empty", "vehicles": {"ego": {"model": "bolt"}}, "control": {"ego": {"kind": "constant"}}}
    assert _left(lambda: assemble({**spec, "plant": {"contact": "tyre"}}).diagram) == []


def test_a_diagram_with_the_blocks_of_a_control_unit_is_freed() -> None:
    assert _left(lambda: assemble("bolt_test_track", expand=True).diagram) == []


@pytest.mark.parametrize("kind", mostly_slow(MOUNTS, fast=5))
def test_a_diagram_with_a_sensor_is_freed(kind: str, tmp_path: Path) -> None:
    mount = {"kind": kind, "rate": 20, **MOUNTS[kind]}
    if "camera" in kind:
        mount |= {"width": 32, "height": 24}
    model = tmp_path / "bolt"
    shutil.copytree(find("models", "bolt"), model)
    (model / "sensors.yaml").write_text(yaml.safe_dump({"mounts": {"one": mount}}), encoding="utf-8")
    car = {"model": str(model)}
    spec = {"world": "test_track", "vehicles": {"ego": car}, "sensors": {"ego": ["one"]}}
    assert _left(lambda: assemble(spec | {"record": {"cameras": "camera" in kind}}).diagram) == []


@pytest.mark.parametrize("kind", mostly_slow(DRIVERS, fast=4))
def test_a_diagram_with_a_driver_is_freed(kind: str) -> None:
    driver = {"ego": {"kind": kind, **DRIVERS[kind]}}
    spec = {"world": "test_track", "vehicles": {"ego": {"model": "bolt"}}, "control": driver}
    assert _left(lambda: assemble(spec).diagram) == []


@pytest.mark.parametrize("tyres", mostly_slow(["brush", "linear", "kinematic"]))
def test_a_single_track_model_is_freed(tyres: str) -> None:
    car = load_vehicle("bolt")

    def make() -> Diagram:
        builder = DiagramBuilder()
        model = builder.AddSystem(make_single_track_vehicle(car, tyres=tyres))
        builder.ExportInput(model.GetInputPort("command"), "command")
        return builder.Build()

    assert _left(make) == []


def test_a_run_leaves_no_diagram_behind(tmp_path: Path) -> None:
    # By type(): isinstance asks lazy objects of other packages for their class, which may warn.
    def living() -> int:
        return sum(issubclass(type(instance), DrakeLeafSystem) for instance in gc.get_objects())

    before = living()
    for index in range(2):
        simulate("bolt_test_track", duration=0.1, folder=tmp_path / str(index))
    gc.collect()
    assert living() <= before
