"""ONNX files: their inputs and outputs, and their evaluation in one thread."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.digest import digest
from mirdrake.core.errors import ConfigError, first_line
from mirdrake.core.extras import import_extra
from mirdrake.core.files import read_errors
from mirdrake.core.json_io import Json, parse_json
from mirdrake.core.signals import Signal

METADATA = "mirdrake"
"""Key of the file's metadata under which an export states rate and contents of the outputs, as JSON."""

_DTYPES: dict[str, type[np.generic]] = {
    "tensor(uint8)": np.uint8,
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
}

Pictures = Literal["colour", "depth"]


@dataclass(frozen=True)
class NetworkInput:
    """Input of a network.

    Attributes:
        name: its name in the file.
        dtype: type of its elements.
        pictures: what pictures it takes; None for a vector.
        height: of the pictures [pixel]; None for any.
        width: of the pictures [pixel]; None for any.
        channels_first: whether pictures are (1, channels, height, width) instead of (1, height, width, channels).
        size: number of elements of a vector.
    """

    name: str
    dtype: type[np.generic]
    pictures: Pictures | None = None
    height: int | None = None
    width: int | None = None
    channels_first: bool = False
    size: int = 0

    def tensor(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values as the network takes them, with a leading axis of length 1.

        Args:
            values: a picture (height, width, channels), or a vector.
        """
        if self.channels_first:
            values = values.transpose(2, 0, 1)
        return np.ascontiguousarray(values[np.newaxis], dtype=self.dtype)


class OnnxNetwork:
    """Network of an ONNX file, evaluated by ONNX Runtime in one thread.

    Args:
        file: path of the file.

    Attributes:
        file: path of the file.
        sha256: hash of the file.
        inputs: its inputs.
        outputs: names and units of the elements of each output.
        rate: evaluations per second that it was made for [Hz]; None if the file does not state it.

    Raises:
        ConfigError: the file cannot be read, or has inputs or outputs that are neither pictures nor vectors.
        MissingDependencyError: ONNX Runtime is not installed.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        if not file.is_file():
            raise ConfigError("there is no such file; expected a network as an ONNX file", where=str(file))
        with read_errors(file):
            # Hash and session have the same bytes, even if the file is replaced in between.
            content = file.read_bytes()
        self.sha256 = digest(content)
        self._session = _make_session(content, file)
        self.inputs = tuple(_read_input(entry, file) for entry in self._session.get_inputs())
        notes = _metadata(self._session.get_modelmeta().custom_metadata_map, file)
        self.rate: float | None = notes.get("rate")
        named = notes.get("outputs", {})
        self.outputs = {
            entry.name: _read_output(entry, named.get(entry.name), file) for entry in self._session.get_outputs()
        }

    def __call__(self, values: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[np.float64]]:
        """Return the outputs (n) by name.

        Args:
            values: a picture (height, width, channels) or a vector for each input, by name.
        """
        feeds = {entry.name: entry.tensor(values[entry.name]) for entry in self.inputs}
        results = self._session.run(None, feeds)
        return {
            name: np.asarray(result, dtype=np.float64).reshape(-1)
            for name, result in zip(self.outputs, results, strict=True)
        }


def _make_session(content: bytes, file: Path) -> Any:
    onnxruntime = import_extra("onnxruntime", need="a network needs ONNX Runtime", extra="network", where=str(file))
    options = onnxruntime.SessionOptions()
    # One thread and sequential execution: sums have a fixed order, so that results are bit-identical.
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 4  # faults are raised; its log would be printed among ours
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its exceptions have no common base but this
        raise ConfigError(
            f"is not a network that ONNX Runtime can read: {first_line(error)}", where=str(file)
        ) from None


def _read_input(entry: Any, file: Path) -> NetworkInput:
    # Free dimensions are names or None in ONNX Runtime.
    shape = [size if isinstance(size, int) else None for size in entry.shape]
    place = f"{file}: input '{entry.name}'"
    if entry.type not in _DTYPES:
        raise ConfigError(f"{place} has type {entry.type}; allowed: {', '.join(_DTYPES)}")
    dtype = _DTYPES[entry.type]
    if shape and shape[0] not in {1, None}:
        raise ConfigError(f"{place} takes {shape[0]} at once; its first axis must be 1 or free")
    if len(shape) == 2 and shape[1] is not None:
        return NetworkInput(entry.name, dtype, size=shape[1])
    if len(shape) == 4 and (shape[3] in {1, 3} or shape[1] in {1, 3}):
        # Channels last wins if both readings are possible, as it is the layout of cameras.
        first = shape[3] not in {1, 3}
        channels, height, width = (shape[1], shape[2], shape[3]) if first else (shape[3], shape[1], shape[2])
        pictures: Pictures = "colour" if channels == 3 else "depth"
        # Whole numbers would round depths in m.
        if pictures == "depth" and dtype == np.uint8:
            raise ConfigError(f"{place} takes depths as whole numbers; depths are numbers in m: use float")
        return NetworkInput(entry.name, dtype, pictures, height, width, first)
    raise ConfigError(
        f"{place} has shape {entry.shape}; allowed: pictures (1, height, width, channels) or "
        "(1, channels, height, width) of 3 channels (colours) or 1 (depths), and vectors (1, n)"
    )


def _read_output(entry: Any, named: Any, file: Path) -> tuple[Signal, ...]:
    size = entry.shape[-1] if entry.shape else 1
    if not isinstance(size, int) or len(entry.shape) > 2:
        raise ConfigError(f"output '{entry.name}' has shape {entry.shape}; allowed: vectors (1, n)", where=str(file))
    # Names of an export are used if they fit; files of others have none.
    if named is not None and len(named) == size:
        return tuple(Signal(str(name), str(unit)) for name, unit in named)
    return tuple(Signal(f"y{index}", "") for index in range(size))


def _metadata(entries: Mapping[str, str], file: Path) -> Json:
    """Return what an export of mirdrake has written about the network; empty for other files."""
    if METADATA not in entries:
        return {}
    with read_errors(file):
        return dict(parse_json(entries[METADATA]))


def metadata_text(rate: float, outputs: Mapping[str, tuple[Signal, ...]], **more: Any) -> str:
    """Return the metadata of a network as JSON.

    Args:
        rate: evaluations per second that it was made for [Hz].
        outputs: names and units of the elements of each output.
        more: further plain data, for the reader of the file.
    """
    named = {name: [[signal.name, signal.unit] for signal in contents] for name, contents in outputs.items()}
    return json.dumps({"rate": rate, "outputs": named, **more}, sort_keys=True)
