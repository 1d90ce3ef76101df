"""Export of a trained network as an ONNX file that takes the pictures of the camera as they are.

Cropping, resizing and scaling are part of the graph, so that the block of a diagram needs no further keys::

    image uint8 (1, height, width, 3) ─ crop ─ resize, round ─ /127.5 - 1 ─ convolutions ┐
    inputs float (1, n) ─────────────── (x - mean)/scale ────────────────────────────────┴ dense ─ · scale ─ y
"""

from pathlib import Path
from typing import Any

import numpy as np

from mirdrake.core.extras import import_extra
from mirdrake.core.files import write_file
from mirdrake.core.signals import Signal
from mirdrake.learning.pilotnet import CONVOLUTIONS, DENSE
from mirdrake.learning.preparation import Preparation
from mirdrake.learning.training import Trained
from mirdrake.networks.onnx_file import METADATA, metadata_text

OPSET, IR_VERSION = 17, 9
"""Versions of the operators and of the file format; ONNX Runtime 1.14 and later reads them."""


def export_onnx(
    trained: Trained, preparation: Preparation, file: Path, *, rate: float, outputs: tuple[Signal, ...], **notes: Any
) -> None:
    """Write a trained network as an ONNX file.

    Args:
        trained: the network.
        preparation: of its pictures.
        file: path of the file.
        rate: pictures per second that it was made for [Hz].
        outputs: names and units of its outputs.
        notes: further plain data for the metadata of the file.

    Raises:
        MissingDependencyError: the package onnx is not installed.
        RunError: the file cannot be written.
    """
    graph = _Graph()
    height, width = preparation.given
    weights = {name: value.detach().contiguous().numpy() for name, value in trained.module.state_dict().items()}

    # The picture: crop, resize, scale, channels first.
    value = _prepare(graph, preparation)
    value = graph.add(
        "Sub", [graph.add("Div", [value, graph.constant(np.float32(127.5))]), graph.constant(np.float32(1.0))]
    )
    value = graph.add("Transpose", [value], perm=[0, 3, 1, 2])

    # The convolutions.
    for index, (_, _, stride) in enumerate(CONVOLUTIONS):
        names = [graph.constant(weights[f"convolutions.{2 * index}.{part}"]) for part in ("weight", "bias")]
        value = graph.add("Relu", [graph.add("Conv", [value, *names], strides=[stride, stride])])
    value = graph.add("Flatten", [value])

    # Further inputs, and the dense layers.
    scaling, extra = trained.scaling, len(trained.scaling.input_mean)
    if extra:
        mean, scale = (np.asarray([part], dtype=np.float32) for part in (scaling.input_mean, scaling.input_scale))
        shifted = graph.add("Sub", ["inputs", graph.constant(mean)])
        value = graph.add("Concat", [value, graph.add("Div", [shifted, graph.constant(scale)])], axis=1)
    for index in range(len(DENSE) + 1):
        names = [graph.constant(weights[f"dense.{2 * index}.{part}"]) for part in ("weight", "bias")]
        value = graph.add("Gemm", [value, *names], transB=1)
        value = graph.add("Relu", [value]) if index < len(DENSE) else value
    graph.add("Mul", [value, graph.constant(np.asarray([scaling.label_scale], dtype=np.float32))], output="y")
    text = metadata_text(rate, {"y": outputs}, **notes)
    write_file(file, graph.file(height, width, inputs=extra, outputs=len(outputs), metadata=text))


def _prepare(graph: "_Graph", preparation: Preparation) -> str:
    """Add cropping and resizing, and return the name of the prepared picture (1, height, width, 3)."""
    rows, columns = preparation.rows, preparation.columns
    limits = [[rows.start, columns.start], [rows.stop, columns.stop], [1, 2]]
    starts, ends, axes = (graph.constant(np.array(limit, dtype=np.int64)) for limit in limits)
    value = graph.add("Cast", [graph.add("Slice", ["image", starts, ends, axes])], to=1)
    if preparation.shape == preparation.cropped:
        return value
    # (1, rows, columns, 3) to (1, 3, rows, columns), so that the matrices act on the last two axes.
    value = graph.add("Transpose", [value], perm=[0, 3, 1, 2])
    value = graph.add("MatMul", [graph.constant(preparation.row_matrix), value])
    value = graph.add("MatMul", [value, graph.constant(np.ascontiguousarray(preparation.column_matrix.T))])
    return graph.add("Transpose", [graph.add("Round", [value])], perm=[0, 2, 3, 1])


class _Graph:
    """Nodes and constants of an ONNX graph under construction."""

    def __init__(self) -> None:
        self._onnx = import_extra("onnx", need="the export of a network needs onnx", extra="learning")
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def add(self, operator: str, inputs: list[str], *, output: str = "", **attributes: Any) -> str:
        """Add a node, and return the name of its output."""
        name = output or f"v{len(self._nodes)}"
        self._nodes.append(self._onnx.helper.make_node(operator, inputs, [name], **attributes))
        return name

    def constant(self, values: Any) -> str:
        """Add a constant, and return its name."""
        name = f"c{len(self._constants)}"
        self._constants.append(self._onnx.numpy_helper.from_array(np.asarray(values), name))
        return name

    def file(self, height: int, width: int, *, inputs: int, outputs: int, metadata: str) -> bytes:
        """Return the content of the file."""
        helper, kinds = self._onnx.helper, self._onnx.TensorProto
        taken = [helper.make_tensor_value_info("image", kinds.UINT8, [1, height, width, 3])]
        if inputs:
            taken.append(helper.make_tensor_value_info("inputs", kinds.FLOAT, [1, inputs]))
        given = [helper.make_tensor_value_info("y", kinds.FLOAT, [1, outputs])]
        graph = helper.make_graph(self._nodes, "pilot", taken, given, self._constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
        entry = model.metadata_props.add()
        entry.key, entry.value = METADATA, metadata
        self._onnx.checker.check_model(model)
        content: bytes = model.SerializeToString(deterministic=True)
        return content
