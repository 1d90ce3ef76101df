"""Error texts of Drake 1.51 and 1.58 have the meaning that mirdrake gives them; irrelevant warnings are suppressed."""

import logging

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder

from mirdrake.core.drake_errors import (
    algebraic_loop,
    first_sentence,
    is_divergence,
    is_meshcat_crash,
    is_solver_failure,
    mesh_fault,
    urdf_fault,
)
from mirdrake.core.drake_log import IRRELEVANT, filter_drake_log

SAP = (  # 1.51 and 1.58
    "The SAP solver failed to converge at simulation time = 0.123. Reasons for divergence and possible solutions "
    "include:\n  1. Externally applied actuation values diverged due to external reasons to the solver."
)
TAMSI = (  # 1.51
    "MultibodyPlant's discrete update solver failed to converge at simulation time = 0.5 with discrete update period "
    "= 0.01. This usually means that the plant's discrete update period is too large to resolve the system's dynamics."
)
NOT_FINITE = (  # 1.51 and 1.58
    "SceneGraph encountered a non-finite value (e.g., NaN or infinity) on a pose input port. It came from the input "
    "associated with source id 1 and name 'plant'.",
    "Detected NaN in the actuation input port for all instances.",
    "Detected NaN in applied generalized force input port.",
)
MESHCAT = (  # 1.51 and 1.58
    "Meshcat's internal websocket thread exited unexpectedly",
    "Meshcat's internal websocket thread crashed via an exception: bad frame",
)
LOOP = (  # 1.51 and 1.58
    "Reported algebraic loop detected in DiagramBuilder:\n  InputPort[0] (u0) of System ::a (Adder<double>) is "
    "direct-feedthrough to\n  OutputPort[0] (sum) of System ::a (Adder<double>) is connected to\n  InputPort[0] (u0) "
    "of System ::b (Adder<double>) is direct-feedthrough to\n  OutputPort[0] (sum) of System ::b (Adder<double>)\n"
)
OTHER = "Input port InputPort[0] (u) of System ::plant (MultibodyPlant<double>) is not connected"


@pytest.mark.parametrize("text", [SAP, TAMSI, *NOT_FINITE])
def test_a_state_that_has_run_away_is_divergence(text: str) -> None:
    assert is_divergence(text)
    assert is_divergence(text.splitlines()[0])
    assert is_solver_failure(text) == (text not in NOT_FINITE)


def test_the_end_of_meshcat_is_recognised() -> None:
    assert all(map(is_meshcat_crash, MESHCAT))


def test_an_algebraic_loop_is_the_ports_on_it() -> None:
    assert algebraic_loop(LOOP) == ["a.u0", "a.sum", "b.u0", "b.sum"]
    builder = DiagramBuilder()
    adder = builder.AddNamedSystem("a", Adder(1, 1))
    builder.Connect(adder.get_output_port(), adder.get_input_port(0))
    with pytest.raises(RuntimeError) as caught:
        builder.Build()
    assert set(algebraic_loop(str(caught.value)) or ()) == {"a.u0", "a.sum"}


def test_other_errors_mean_none_of_these() -> None:
    assert not any(meaning(OTHER) for meaning in (is_divergence, is_solver_failure, is_meshcat_crash))
    assert algebraic_loop(OTHER) is None


def test_warnings_that_do_not_apply_are_suppressed_and_others_are_not(caplog: pytest.LogCaptureFixture) -> None:
    logger = logging.getLogger("drake")
    filter_drake_log()
    before = len(logger.filters)
    filter_drake_log()
    assert len(logger.filters) == before
    with caplog.at_level(logging.WARNING, logger="drake"):
        for text in (*IRRELEVANT, "joint friction is not supported"):
            assert logger.filter(logging.makeLogRecord({"msg": f"Warning: {text}."})) == (text not in IRRELEVANT)


def test_a_fault_of_a_urdf_text_is_its_line_and_reason() -> None:
    assert urdf_fault("error: no links") == (0, "no links")
    assert urdf_fault("<literal-string>.urdf:12: error: joint 'a':\n  its axis is zero") == (
        12,
        "joint 'a': its axis is zero",
    )


def test_a_fault_of_a_mesh_is_its_last_part() -> None:
    assert mesh_fault("MakeConvexHull(): 'car.gltf': the buffer view\n has no data") == "the buffer view has no data"


def test_the_first_sentence_leaves_out_the_causes() -> None:
    assert first_sentence(SAP) == "The SAP solver failed to converge at simulation time = 0.123"
    assert first_sentence(LOOP) == "Reported algebraic loop detected in DiagramBuilder:"
