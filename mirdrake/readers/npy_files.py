"""Arrays of NumPy: ``.npy`` and ``.npz``."""

from io import BytesIO

import numpy as np

from mirdrake.core.errors import ConfigError
from mirdrake.readers.tables import Request, Table, read_bytes, vectors


def read_npy(request: Request) -> Table:
    """Read an array, or the arrays of an archive by name; fields of a structured array, columns of a matrix from 1.

    Raises:
        ConfigError: the file is damaged, has objects, or has no numbers.
    """
    raw = read_bytes(request.path)
    try:
        # Objects are stored as pickles, which may execute code: they are not read.
        content = np.load(BytesIO(raw), allow_pickle=False)
        arrays = dict(content) if isinstance(content, np.lib.npyio.NpzFile) else content
    except Exception as error:  # NumPy and zipfile raise errors of many kinds on damaged files
        reason = "has Python objects; save arrays of numbers" if "pickle" in str(error) else "is damaged"
        raise ConfigError(f"is not an array file of NumPy, or {reason}", where=request.name) from None
    columns = vectors(arrays)
    if not columns:
        raise ConfigError("has no vectors of numbers", where=request.name)
    return Table(request.name, list(columns), columns)
