"""PilotNet: five convolutions and four dense layers, about 250 000 parameters for pictures of 200 x 66 pixels.

Source: M. Bojarski et al., "End to end learning for self-driving cars", arXiv 1604.07316, 2016, figure 4.

The architecture is data (:class:`Architecture`), from which training builds a PyTorch module and the export an ONNX
graph. Further inputs such as the speed are concatenated with the features before the first dense layer.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mirdrake.core.errors import ConfigError
from mirdrake.core.extras import import_extra

if TYPE_CHECKING:
    import torch

CONVOLUTIONS = ((24, 5, 2), (36, 5, 2), (48, 5, 2), (64, 3, 1), (64, 3, 1))
"""Channels, size of the kernel and stride of each convolution (Bojarski et al., figure 4)."""

DENSE = (100, 50, 10)
"""Units of the dense layers before the output."""


@dataclass(frozen=True)
class Architecture:
    """A PilotNet for pictures of one size.

    Attributes:
        height: of the prepared pictures [pixel].
        width: of the prepared pictures [pixel].
        inputs: number of further inputs.
        outputs: number of outputs.
    """

    height: int
    width: int
    inputs: int = 0
    outputs: int = 1

    def features(self) -> int:
        """Return the number of features after the convolutions.

        Raises:
            ConfigError: the pictures are too small.
        """
        height, width = self.height, self.width
        for _, kernel, stride in CONVOLUTIONS:
            height, width = (height - kernel) // stride + 1, (width - kernel) // stride + 1
        if min(height, width) < 1:
            smallest = 1
            for _, kernel, stride in reversed(CONVOLUTIONS):
                smallest = (smallest - 1) * stride + kernel
            raise ConfigError(
                f"picture: {self.width} x {self.height} pixels are too few for PilotNet; it needs "
                f"{smallest} x {smallest} after cropping and resizing"
            )
        return CONVOLUTIONS[-1][0] * height * width


def import_torch() -> Any:
    """Return PyTorch.

    Raises:
        MissingDependencyError: it is not installed.
    """
    return import_extra("torch", need="training needs PyTorch", extra="learning")


def make_pilotnet(architecture: Architecture) -> "torch.nn.Module":
    """Return an untrained PilotNet as a PyTorch module.

    Its forward function takes pictures (n, 3, height, width) scaled to -1 to 1 and further inputs (n, inputs), scaled,
    and returns (n, outputs), scaled.

    Raises:
        ConfigError: the pictures are too small.
        MissingDependencyError: PyTorch is not installed.
    """
    torch = import_torch()
    nn = torch.nn
    layers: list[Any] = []
    # The order of the layers determines the names of the weights, which the export reads.
    channels = 3
    for count, kernel, stride in CONVOLUTIONS:
        layers += [nn.Conv2d(channels, count, kernel, stride), nn.ReLU()]
        channels = count
    convolutions = nn.Sequential(*layers, nn.Flatten())
    units, dense = architecture.features() + architecture.inputs, []
    # No activation after the last layer: steering has both signs.
    for count in DENSE:
        dense += [nn.Linear(units, count), nn.ReLU()]
        units = count
    dense.append(nn.Linear(units, architecture.outputs))

    class PilotNet(nn.Module):  # type: ignore[name-defined]
        """Five convolutions, then four dense layers."""

        def __init__(self) -> None:
            super().__init__()
            self.convolutions, self.dense = convolutions, nn.Sequential(*dense)
            self.inputs = architecture.inputs

        def forward(self, pictures: Any, inputs: Any) -> Any:
            """Return the outputs."""
            features = self.convolutions(pictures)
            return self.dense(torch.cat([features, inputs], dim=1))

    # The layout of the stored pictures, which convolutions then read without conversion.
    return PilotNet().to(memory_format=torch.channels_last)
