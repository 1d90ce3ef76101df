"""Cloning: the network, its export, training that repeats and continues, delay, drives, and faults of studies."""

import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from mirdrake.core.errors import ConfigError, MissingDependencyError
from mirdrake.core.signals import Signal
from mirdrake.learning.data import DrivingData
from mirdrake.learning.delays import DelayMargin, delay_sentence, is_delay_the_cause
from mirdrake.learning.drives import (
    INTERVENTION_TIME,
    Car,
    Drive,
    Figures,
    drive,
    with_delay,
    with_errors,
    with_network,
)
from mirdrake.learning.pilotnet import Architecture
from mirdrake.learning.preparation import CropSpec, Preparation
from mirdrake.learning.spec import LearningSpec, load_learning
from mirdrake.report.learning import headline

STUDIES = Path(__file__).resolve().parent.parent / "studies"
NO_TORCH = "needs PyTorch, which is not part of the development extras: pip install 'mirdrake[learning]'"


@pytest.fixture(autouse=True)
def _inductor_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Set what PyTorch would set in the environment."""
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", str(tmp_path))


def _line_data(folder: Path, count: int, *, seed: int = 0) -> DrivingData:
    """Return pictures of a bright vertical line; the label is its place, from -1 to 1, and an input half of it."""
    random = np.random.default_rng(seed)
    places = random.uniform(-1.0, 1.0, count)
    pictures = random.integers(0, 40, (count, 62, 64, 3), dtype=np.uint8)
    columns = np.rint(31.5 + 25.0 * places).astype(int)
    for picture, column in zip(pictures, columns, strict=True):
        picture[:, column - 2 : column + 3] = 220
    np.save(folder / f"lines-{seed}.npy", pictures)
    table = pd.DataFrame({"row": np.arange(count), "time": 0.0, "place": 0.0, "half": 0.5 * places, "label": places})
    preparation = Preparation(64, 62, CropSpec())
    return DrivingData(folder / f"lines-{seed}.npy", table, ("half",), ("label",), preparation)


def test_pilotnet_has_the_size_of_the_paper() -> None:
    torch = pytest.importorskip("torch", reason=NO_TORCH)
    from mirdrake.learning.pilotnet import make_pilotnet

    module = make_pilotnet(Architecture(66, 200))
    assert sum(parameter.numel() for parameter in module.parameters()) == 252_219
    assert module(torch.zeros(2, 3, 66, 200), torch.zeros(2, 0)).shape == (2, 1)


def test_pictures_that_are_too_small_for_pilotnet_are_rejected() -> None:
    assert Architecture(61, 61).features() == 64
    with pytest.raises(ConfigError, match="picture: 200 x 60 pixels are too few for PilotNet; it needs 61 x 61"):
        Architecture(60, 200).features()


def test_training_learns_repeats_and_continues(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason=NO_TORCH)
    from mirdrake.learning.spec import TrainSpec
    from mirdrake.learning.training import train

    data, held = _line_data(tmp_path, 128), _line_data(tmp_path, 32, seed=1)
    spec = TrainSpec(epochs=2, batch=32, mirror=False)
    file = tmp_path / "training.pt"
    first = train(data, held, spec, seed=3, file=file)
    weights = [value.numpy() for value in first.module.state_dict().values()]

    # The same seed gives the same weights, also if the training is stopped after its first epoch.
    class StopError(Exception):
        pass

    def stop(done: int, total: int, text: str) -> None:
        if done > len(data):
            raise StopError

    with pytest.raises(StopError):
        train(data, held, spec, seed=3, file=tmp_path / "stopped.pt", report=stop)
    second = train(data, held, spec, seed=3, file=tmp_path / "stopped.pt")
    assert all(np.array_equal(a, b.numpy()) for a, b in zip(weights, second.module.state_dict().values(), strict=True))
    assert second.training_loss == first.training_loss
    other = train(data, held, TrainSpec(epochs=1, batch=32, mirror=False), seed=4)
    assert not np.array_equal(weights[0], next(iter(other.module.state_dict().values())).numpy())
    assert first.training_loss[1] < first.training_loss[0]


def _trained(folder: Path, preparation: Preparation, inputs: int) -> Any:
    """Return an untrained network as a training returns it."""
    import torch

    from mirdrake.learning.pilotnet import make_pilotnet
    from mirdrake.learning.training import Scaling, Trained

    torch.manual_seed(0)
    architecture = Architecture(*preparation.shape, inputs)
    scaling = Scaling((4.0,) * inputs, (2.0,) * inputs, (0.3,))
    module = make_pilotnet(architecture)
    for parameter in module.parameters():
        parameter.data *= 1.5  # the outputs of the usual initial weights hardly depend on the picture
    return Trained(module, architecture, scaling, [], [], 0)


@pytest.mark.parametrize(("size", "inputs"), [(None, 0), ((100, 62), 2)])
def test_the_exported_network_equals_pytorch_within_1e_5_rad(
    tmp_path: Path, size: tuple[int, int] | None, inputs: int
) -> None:
    pytest.importorskip("torch", reason=NO_TORCH)
    pytest.importorskip("onnxruntime")
    from mirdrake.learning.exporting import export_onnx
    from mirdrake.networks.onnx_file import OnnxNetwork

    preparation = Preparation(200, 112, CropSpec(top=50), size)
    trained = _trained(tmp_path, preparation, inputs)
    export_onnx(trained, preparation, tmp_path / "pilot.onnx", rate=10.0, outputs=(Signal("steering", "rad"),))
    network = OnnxNetwork(tmp_path / "pilot.onnx")
    assert network.rate == 10.0
    random = np.random.default_rng(1)
    blocks = random.integers(0, 256, (500, 4, 8, 3), dtype=np.uint8)
    pictures = blocks.repeat(28, axis=1).repeat(25, axis=2)
    values = random.uniform(0.0, 10.0, (500, inputs))
    expected = trained.evaluate(np.stack([preparation(picture) for picture in pictures]), values)[:, 0]
    given = [
        network({"image": picture, "inputs": value} if inputs else {"image": picture})["y"][0]
        for picture, value in zip(pictures, values, strict=True)
    ]
    assert np.ptp(expected) > 1e-4  # the pictures make a difference
    assert given == pytest.approx(expected, abs=1e-5)


@pytest.mark.slow
def test_a_loop_of_pictures_runs_at_three_times_real_time_and_a_network_takes_3_ms(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason=NO_TORCH)
    pytest.importorskip("onnxruntime")
    from mirdrake.learning.exporting import export_onnx
    from mirdrake.networks.onnx_file import OnnxNetwork
    from mirdrake.runs.simulation import simulate

    preparation = Preparation(200, 112, CropSpec(top=50))
    file = tmp_path / "pilot.onnx"
    export_onnx(_trained(tmp_path, preparation, 0), preparation, file, rate=10.0, outputs=(Signal("steering", "rad"),))
    network, picture = OnnxNetwork(file), np.zeros((112, 200, 3), dtype=np.uint8)
    began = time.process_time()
    for _ in range(200):
        network({"image": picture})
    assert (time.process_time() - began) / 200 < 3e-3

    camera = {"width": 200, "height": 112, "rate": 10}
    diagram = {
        "world": "test_track",
        "vehicles": {"ego": {"model": "bolt", "start": "line", "mounts": {"front_camera": camera}}},
        "control": {"ego": {"kind": "path_tracking", "track": "main", "speed": 5.0}},
        "sensors": {"ego": ["front_camera"]},
        "systems": {"pilot": {"kind": "network", "file": str(file), "image": "ego.front_camera"}},
        "connect": [["pilot.y", "ego.control.steering_reference"]],
        "plant": {"contact": "point"},
    }
    simulate(diagram, duration=1.0)  # the first run loads the renderer
    began = time.process_time()
    simulate(diagram, duration=30.0)
    assert time.process_time() - began < 30.0 / 3.0


def test_the_saliency_of_a_linear_network_is_the_size_of_its_weights() -> None:
    torch = pytest.importorskip("torch", reason=NO_TORCH)
    from mirdrake.learning.explain import find_saliency

    weights = torch.linspace(-1.0, 1.0, 6 * 8).reshape(6, 8)

    def linear(pictures: Any, inputs: Any) -> Any:
        assert inputs.shape == (len(pictures), 0)
        return (pictures.sum(dim=1) * weights).sum(dim=(1, 2))[:, None]

    saliency = find_saliency(linear, np.full((2, 6, 8, 3), 100, dtype=np.uint8))
    expected = np.abs(weights.numpy()) / np.percentile(np.abs(weights.numpy()), 99.5)
    assert saliency[0] == pytest.approx(np.minimum(expected, 1.0), abs=1e-5)
    assert np.array_equal(saliency[0], saliency[1])


MARGIN = DelayMargin(0.0, 0.025, 0.025, 0.4, 3.5, 1.4, 1.3, 1.27, 1.32)


def _figures(**changes: Any) -> Figures:
    base = {"laps": 1.0, "time": 200.0, "interventions": 0, "autonomy": 1.0, "rms": 0.02, "largest": 0.1}
    return Figures(**{**base, "off_road": 0.0, "finished": True, **changes})


def test_the_delay_is_named_as_the_cause_if_a_perfect_copy_does_not_drive() -> None:
    assert not is_delay_the_cause(MARGIN, _figures())
    assert "The delay is not a cause" in delay_sentence(MARGIN, _figures())
    for bad in (_figures(off_road=0.5), _figures(interventions=1), _figures(finished=False)):
        assert is_delay_the_cause(MARGIN, bad)
        assert "the delay is the cause: increase the rate" in delay_sentence(MARGIN, bad)
    late = DelayMargin(0.3, 0.05, 0.0, 0.4, 3.5, 1.4, 0.2, 1.27, 5.0)
    assert is_delay_the_cause(late, _figures())


def test_the_autonomy_is_that_of_the_pilotnet_paper() -> None:
    # Bojarski et al., section 7: 10 interventions in 600 s are an autonomy of 90 %.
    assert pytest.approx(0.9) == 1.0 - INTERVENTION_TIME * 10 / 600.0


def test_the_headline_is_that_of_a_drive_that_was_not_finished() -> None:
    drives = {"a": Drive((), _figures(autonomy=0.9)), "b": Drive((), _figures(laps=0.4, finished=False))}
    result: Any = SimpleNamespace(last=SimpleNamespace(drives=drives))
    assert headline(result) == (
        "The network drives 0.40 laps in 2 worlds, the worst of which is b with 0 interventions, not finished: "
        "autonomy 100.0 %"
    )


RING: dict[str, Any] = {
    "mirdrake": "world/1",
    "ground": {"surface": "grass", "mu": 0.5},
    "tracks": {"main": {"random": {"length": 120, "corners": 4, "min_radius": 8, "max_radius": 12}}},
    "start": {"line": {"on_track": {"track": "main", "s": 0}}},
}


def test_an_intervention_is_counted_when_the_car_leaves_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ring.yaml").write_text(yaml.safe_dump(RING, sort_keys=False), encoding="utf-8")
    diagram: dict[str, Any] = {
        "world": str(tmp_path / "ring.yaml"),
        "vehicles": {"ego": {"model": "bolt"}},
        "control": {"ego": {"kind": "path_tracking", "speed": 5}},
        "plant": {"contact": "point", "time_step": 0.02},
        "duration": 0.5,
        "record": {"report": False, "meshcat": False},
    }
    car = Car("ego", "front_camera")
    # The time ends before the lap, on the line: not finished, but no intervention either.
    ended = drive(diagram, car, tmp_path / "ended", base=tmp_path, laps=1.0, limit=float("inf"))
    assert (ended.figures.finished, ended.figures.interventions, ended.figures.autonomy) == (False, 0, 1.0)
    assert len(ended.folders) == 1
    # Every place counts as off the line: each segment ends at its first check with an intervention, up to the limit.
    monkeypatch.setattr("mirdrake.learning.drives.MOST_INTERVENTIONS", 3)
    left = drive(diagram, car, tmp_path / "left", base=tmp_path, laps=1.0, limit=-1.0)
    assert (left.figures.finished, left.figures.interventions, len(left.folders)) == (False, 3, 3)


def test_injected_errors_have_the_given_size_and_repeat() -> None:
    diagram: dict[str, Any] = {"vehicles": {"ego": {}}, "control": {"ego": {}}}
    car = Car("ego", "front_camera")
    changed = with_errors(diagram, car, rms=0.1, seed=(0, 1, 2))
    sines = [entry for entry in changed["systems"].values() if entry["kind"] == "sine"]
    times = np.arange(0.0, 2000.0, 0.05)
    total = sum(s["amplitude"] * np.sin(2.0 * np.pi * s["frequency"] * times + s["phase"]) for s in sines)
    assert np.sqrt(np.mean(total**2)) == pytest.approx(0.1, rel=0.02)
    assert with_errors(diagram, car, rms=0.1, seed=(0, 1, 2)) == changed
    assert with_errors(diagram, car, rms=0.1, seed=(0, 1, 3)) != changed
    assert with_errors(diagram, car, rms=0.0, seed=(0, 1, 2)) == diagram


def test_a_network_replaces_the_steering_of_the_expert_only() -> None:
    car = Car("ego", "front_camera")
    diagram: dict[str, Any] = {
        "connect": [["a.y", "ego.steering_reference"], ["b.y", "ego.speed_reference"]],
        "systems": {},
    }
    changed = with_network(diagram, car, file=Path("pilot.onnx"), latency=0.05, inputs=["vx", "wz"])
    assert changed["connect"] == [
        ["b.y", "ego.speed_reference"],
        ("pilot.y", "ego.steering_reference"),
        ("ego.vx", "pilot.inputs.inputs0"),
        ("ego.wz", "pilot.inputs.inputs1"),
    ]
    delayed = with_delay(diagram, car, rate=10.0, latency=0.025)
    assert delayed["systems"]["late"]["delay"] == 0.025
    assert delayed["systems"]["late"]["period"] == pytest.approx(0.0125)


def test_the_shipped_study_can_be_read() -> None:
    spec = load_learning(STUDIES / "clone_bolt.yaml")
    assert spec.name == "clone_bolt"
    assert spec.label_lead == pytest.approx(0.025)
    changed = load_learning(STUDIES / "clone_bolt.yaml", overrides=["overrides.control.ego.speed=8"])
    assert changed.overrides["control.ego.speed"] == 8
    assert changed.overrides["plant.contact"] == "point"
    assert LearningSpec(diagram="bolt_test_track", rounds=2).rounds.count == 2


def _study(folder: Path, **changes: Any) -> Path:
    data = {"mirdrake": "learning/1", "diagram": "bolt_test_track", "picture": {"crop": {"top": 50}}, **changes}
    data.setdefault("overrides", {"vehicles.ego.mounts": {"front_camera": {"width": 200, "height": 112}}})
    file = folder / "study.yaml"
    file.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"camera": "front_kamera"}, r"camera: ego has no camera 'front_kamera'; did you mean 'front_camera'"),
        ({"vehicle": "ega"}, r"vehicle: the diagram has no vehicle 'ega'; did you mean 'ego'"),
        ({"picture": {"crop": {"top": 60}}}, r"picture: .*200 x 52 pixels are too few for PilotNet"),
        ({"diagram": "bolt_test_trak"}, r"diagram: unknown diagram 'bolt_test_trak'; did you mean 'bolt_test_track'"),
        ({"worlds": ["skid_pad"]}, r"worlds: .*unknown world 'skid_pad'; did you mean 'skidpad'"),
        ({"overrides": {"control.ego.sped": 5}}, r"overrides\.control\.ego\.sped: .*sped: unknown field"),
        ({"train": {"epochs": 0}}, r"train\.epochs"),
        ({"inputs": ["progress"]}, r"inputs: input 'ego\.progress' has no known mirrored value"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_a_fault_of_a_study_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], message: str
) -> None:
    import mirdrake.learning.clone as module

    monkeypatch.setattr(module, "_check_packages", lambda: None)  # the faults are found without PyTorch
    with pytest.raises(ConfigError, match=message) as error:
        module.clone(_study(tmp_path, **changes), out=tmp_path / "out")
    assert "\n" not in str(error.value)


def test_without_torch_the_error_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mirdrake.learning.clone import clone

    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingDependencyError, match=r"training needs PyTorch: pip install 'mirdrake\[learning\]'"):
        clone(_study(tmp_path), out=tmp_path / "out")
