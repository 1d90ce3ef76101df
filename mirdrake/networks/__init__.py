"""Neural networks in ONNX files as blocks of a diagram."""

from mirdrake.networks.block import NetworkBlock as NetworkBlock
