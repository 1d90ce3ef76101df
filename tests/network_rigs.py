"""Small ONNX networks and a source of pictures, for tests of the block of networks."""

from pathlib import Path

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context
from pydrake.systems.sensors import ImageRgba8U

from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import Signal
from mirdrake.networks.onnx_file import METADATA, metadata_text


def write_mean_network(
    file: Path, *, width: int = 4, height: int = 3, rate: float | None = 20.0, vector: int = 0, first: bool = False
) -> Path:
    """Write a network whose output is the mean of the red channel [0 to 255], plus the sum of a vector."""
    import onnx
    from onnx import TensorProto, helper

    shape, axes = ([1, 3, height, width], [2, 3]) if first else ([1, height, width, 3], [1, 2])
    nodes = [
        helper.make_node("Cast", ["picture"], ["numbers"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMean", ["numbers"], ["means"], keepdims=0, axes=axes),
        helper.make_node("MatMul", ["means", "red"], ["y" if not vector else "red_mean"]),
    ]
    inputs = [helper.make_tensor_value_info("picture", TensorProto.UINT8, shape)]
    if vector:
        inputs.append(helper.make_tensor_value_info("numbers_in", TensorProto.FLOAT, [1, vector]))
        nodes.append(helper.make_node("ReduceSum", ["numbers_in"], ["sum"], keepdims=1))
        nodes.append(helper.make_node("Add", ["red_mean", "sum"], ["y"]))
    output = helper.make_tensor_value_info("y", TensorProto.FLOAT, [1, 1])
    weights = helper.make_tensor("red", TensorProto.FLOAT, [3, 1], [1.0, 0.0, 0.0])
    model = helper.make_model(
        helper.make_graph(nodes, "mean", inputs, [output], [weights]),
        opset_imports=[helper.make_opsetid("", 13 if vector else 17)],
        ir_version=9,
    )
    if rate is not None:
        entry = model.metadata_props.add()
        entry.key, entry.value = METADATA, metadata_text(rate, {"y": (Signal("steering", "rad"),)})
    onnx.save(model, str(file))
    return file


class Clock(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Source of pictures whose red channel is the time in hundredths of a second; without a picture before `start`.

    Output ports:
        image: colours of a size.

    Args:
        width: [pixel].
        height: [pixel].
        start: time of the first picture [s].
    """

    def __init__(self, width: int = 4, height: int = 3, start: float = 0.0) -> None:
        super().__init__()
        self._start = start
        model = AbstractValue.Make(ImageRgba8U(width, height))
        self.DeclareAbstractOutputPort("image", model.Clone, self._draw)

    def _draw(self, context: Context, value: AbstractValue) -> None:
        data = value.get_mutable_value().mutable_data
        data[:, :, 0] = np.uint8(round(100.0 * context.get_time()))
        data[:, :, 3] = 255 if context.get_time() >= self._start else 0
