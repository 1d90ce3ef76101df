"""The block of networks: results, rate, latency, pictures of other sizes, files that are no networks."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import VectorLogSink

from mirdrake.assembly.blocks import make_block
from mirdrake.assembly.diagram import assemble
from mirdrake.core.errors import ConfigError, MissingDependencyError
from mirdrake.core.signals import signals_of
from mirdrake.core.yaml_io import Source
from mirdrake.networks.block import Network, NetworkBlock
from mirdrake.networks.onnx_file import OnnxNetwork
from mirdrake.runs.simulation import simulate
from tests.network_rigs import Clock, write_mean_network

pytest.importorskip("onnx", reason="the test writes networks with the package onnx: pip install 'mirdrake[learning]'")
pytest.importorskip("onnxruntime", reason="needs ONNX Runtime: pip install 'mirdrake[network]'")


def _outputs(network: Network, times: list[float], *, start: float = 0.0) -> list[float]:
    """Return the output of a network that sees a clock, at times [s]."""
    builder = DiagramBuilder()
    clock, block = builder.AddSystem(Clock(start=start)), builder.AddSystem(network)
    builder.Connect(clock.get_output_port(), block.GetInputPort("image"))
    sink = builder.AddSystem(VectorLogSink(1))
    builder.Connect(block.GetOutputPort("y"), sink.get_input_port())
    simulator = Simulator(builder.Build())
    values = []
    for time in times:
        simulator.AdvanceTo(time)
        context = block.GetMyContextFromRoot(simulator.get_context())
        values.append(float(block.GetOutputPort("y").Eval(context)[0]))
    return values


def test_a_network_is_evaluated_at_its_rate_and_its_output_is_held(tmp_path: Path) -> None:
    network = Network(OnnxNetwork(write_mean_network(tmp_path / "mean.onnx")))
    # Evaluations at 0, 0.05, 0.1 s read the time in hundredths of a second.
    assert _outputs(network, [0.04, 0.051, 0.09, 0.101]) == pytest.approx([0.0, 5.0, 5.0, 10.0])


def test_the_latency_delays_the_output_exactly(tmp_path: Path) -> None:
    file = write_mean_network(tmp_path / "mean.onnx")
    # The picture of 0.10 s acts from 0.10 s + 0.12 s on, which is after the pictures of 0.15 s and 0.20 s were taken.
    network = Network(OnnxNetwork(file), latency=0.12)
    assert _outputs(network, [0.2199, 0.2201, 0.2699, 0.2701]) == pytest.approx([5.0, 10.0, 10.0, 15.0])


def test_before_the_first_picture_the_output_is_the_initial_one(tmp_path: Path) -> None:
    network = Network(OnnxNetwork(write_mean_network(tmp_path / "mean.onnx")), initial=[7.0])
    assert _outputs(network, [0.06, 0.19, 0.201], start=0.2) == pytest.approx([7.0, 7.0, 20.0])


def test_vectors_and_pictures_with_channels_first_are_inputs_as_well(tmp_path: Path) -> None:
    network = OnnxNetwork(write_mean_network(tmp_path / "mean.onnx", vector=2, first=True))
    picture = np.zeros((3, 4, 3), dtype=np.uint8)
    picture[:, :2, 0] = 100
    assert network({"picture": picture, "numbers_in": np.array([0.25, 0.5])})["y"] == pytest.approx([50.75])


def test_the_file_states_rate_and_units(tmp_path: Path) -> None:
    network = Network(OnnxNetwork(write_mean_network(tmp_path / "mean.onnx", rate=12.5)))
    assert network.rate == 12.5
    contents = signals_of(network.GetOutputPort("y"))
    assert contents is not None
    assert [(signal.name, signal.unit) for signal in contents] == [("steering", "rad")]
    assert Network(OnnxNetwork(write_mean_network(tmp_path / "plain.onnx", rate=None))).rate == 20.0


def _diagram(file: Path, *, width: int = 32, image: str = "ego.front_camera") -> dict[str, Any]:
    camera = {"width": width, "height": 24, "rate": 20}
    return {
        "world": "test_track",
        "vehicles": {"ego": {"model": "bolt", "start": "line", "mounts": {"front_camera": camera}}},
        "control": {"ego": {"kind": "path_tracking", "track": "main", "speed": 5.0}},
        "sensors": {"ego": ["front_camera"]},
        "systems": {"pilot": {"kind": "network", "file": str(file), "image": image}},
        "connect": [["pilot.y", "ego.control.steering_reference"]],
        "plant": {"contact": "point"},
    }


def test_a_network_steers_a_car_and_its_hash_is_in_the_run(tmp_path: Path) -> None:
    file = write_mean_network(tmp_path / "mean.onnx", width=32, height=24)
    run = simulate(_diagram(file), duration=0.2)
    assert run["pilot.y"].iloc[0] == 0.0
    assert run["pilot.y"].iloc[-1] > 10.0  # the sky and the road are not black
    assert run.spec["provenance"]["content_sha256"]["pilot"] == OnnxNetwork(file).sha256


def test_pictures_of_another_size_are_rejected_when_the_diagram_is_built(tmp_path: Path) -> None:
    file = write_mean_network(tmp_path / "mean.onnx", width=64, height=24)
    with pytest.raises(ConfigError, match=r"gives pictures of 32 x 24 pixels, 'pilot.image' takes 64 x 24; set width"):
        assemble(_diagram(file))


def test_an_unknown_camera_is_rejected_with_the_line_of_the_block(tmp_path: Path) -> None:
    file = write_mean_network(tmp_path / "mean.onnx", width=32, height=24)
    with pytest.raises(ConfigError, match=r"systems\.pilot\.image: unknown output 'ego.front_kamera'"):
        assemble(_diagram(file, image="ego.front_kamera"))


def _make(file: Path, **keys: Any) -> Any:
    return make_block(
        "network", {"file": str(file), **keys}, source=Source("drive.yaml", {(): 3}, ("systems", "pilot"))
    )


def test_a_file_that_is_no_network_is_reported_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"systems\.pilot: .*missing\.onnx: there is no such file") as missing:
        _make(tmp_path / "missing.onnx")
    (tmp_path / "bad.onnx").write_bytes(b"not a network")
    with pytest.raises(ConfigError, match=r"bad\.onnx: is not a network that ONNX Runtime can read") as bad:
        _make(tmp_path / "bad.onnx")
    for error in (missing, bad):
        assert "\n" not in str(error.value)


def test_an_initial_output_of_another_size_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"initial has 2 elements, the output of .* has 1"):
        _make(write_mean_network(tmp_path / "mean.onnx"), initial=[0.0, 0.0])


def test_without_onnx_runtime_the_error_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write_mean_network(tmp_path / "mean.onnx")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingDependencyError, match=r"systems\.pilot: .*pip install 'mirdrake\[network\]'"):
        _make(file)


def test_diagrams_without_a_network_import_neither_onnx_runtime_nor_torch() -> None:
    code = (
        "import sys, mirdrake.assembly.diagram, mirdrake.learning, mirdrake.gym\n"
        "print(sorted({'torch', 'onnx', 'onnxruntime'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_a_block_needs_a_file() -> None:
    assert NetworkBlock.model_json_schema()["required"] == ["file"]
