"""MAT files of MATLAB."""

import pickle
import subprocess
import sys
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from mirdrake.core.errors import ConfigError
from mirdrake.core.extras import import_extra
from mirdrake.core.yaml_io import display_path
from mirdrake.readers.tables import Request, Table, read_bytes, vectors


def read_mat(request: Request) -> Table:
    """Read a MAT file: vectors by name, fields of structs and timeseries as ``struct.field``.

    Version 7.3 is HDF5 and needs h5py.
    """
    path, raw = request.path, read_bytes(request.path)
    content = (_read_hdf5 if raw[:10] == b"MATLAB 7.3" else _read_mat5)(path, raw)
    columns = vectors({key: value for key, value in content.items() if not key.startswith(("__", "#"))})
    if not columns:
        raise ConfigError("has no vectors of numbers", where=display_path(path))
    return Table(display_path(path), list(columns), columns)


MAT_TIME = 20.0
"""Time limit of reading a MAT file [s]."""

_READ_MAT = """
import pickle, sys
from io import BytesIO
from scipy.io import loadmat
pickle.dump(loadmat(BytesIO(sys.stdin.buffer.read()), simplify_cells=True), sys.stdout.buffer)
"""


def _read_mat5(path: Path, raw: bytes) -> dict[str, Any]:
    """Return the contents of a MAT file before version 7.3.

    It is read in another process, as compiled code of SciPy crashes on some damaged files.
    """
    # -P: modules in the working directory are not imported.
    command = [sys.executable, "-P", "-W", "ignore", "-c", _READ_MAT]
    try:
        done = subprocess.run(command, input=raw, capture_output=True, timeout=MAT_TIME, check=True)
        content: dict[str, Any] = pickle.loads(done.stdout)
    except subprocess.TimeoutExpired:
        raise ConfigError(f"cannot be read within {MAT_TIME:g} s; is it damaged?", where=display_path(path)) from None
    except (subprocess.SubprocessError, EOFError, pickle.UnpicklingError):
        raise ConfigError("is not a MAT file, or is damaged", where=display_path(path)) from None
    return content


def _read_hdf5(path: Path, raw: bytes) -> dict[str, Any]:
    """Return the numbers of a MAT file of version 7.3, groups as mappings."""
    need = "is MAT version 7.3, which needs h5py"
    h5py = import_extra("h5py", need=need, extra="bags", otherwise="; or save it with -v7", where=display_path(path))

    def plain(item: Any) -> Any:
        # Groups are structures; texts and references have no numbers.
        if isinstance(item, h5py.Group):
            return {key: plain(inner) for key, inner in item.items()}
        return np.asarray(item) if item.dtype.kind in "biuf" else None

    try:
        with h5py.File(BytesIO(raw), "r") as file:
            return {key: plain(item) for key, item in file.items()}
    except Exception:  # h5py raises errors of many kinds on a damaged file
        raise ConfigError("claims to be MAT version 7.3, but is damaged", where=display_path(path)) from None
