"""Pickles of plain arrays, lists and mappings, without executing code.

A pickle may name any function and call it. Here only the constructors of NumPy arrays are found (Python documentation,
module pickle, "Restricting Globals"), so that a pickle of anything else is rejected before anything is called.
"""

import io
import pickle
from typing import Any

from mirdrake.core.errors import ConfigError
from mirdrake.readers.tables import Request, Table, read_bytes, vectors

_ALLOWED = {
    ("numpy", "ndarray"), ("numpy", "dtype"), ("collections", "OrderedDict"), ("_codecs", "encode"),
    *((f"numpy.{core}.{module}", name) for core in ("core", "_core")
      for module, name in (("multiarray", "_reconstruct"), ("multiarray", "scalar"), ("numeric", "_frombuffer"))),
}  # fmt: skip
"""Modules and names that a pickle of arrays needs; none of them runs other code."""


class _ArrayUnpickler(pickle.Unpickler):
    """Unpickler of plain data."""

    def find_class(self, module: str, name: str) -> Any:
        """Return an allowed constructor.

        Raises:
            pickle.UnpicklingError: any other name.
        """
        if (module, name) not in _ALLOWED:
            raise pickle.UnpicklingError(f"{module}.{name}")
        return super().find_class(module, name)


def read_pickle(request: Request) -> Table:
    """Read vectors by name; entries of mappings are ``outer.inner``, columns of a matrix are numbered from 1.

    Raises:
        ConfigError: the file is damaged, has other objects, or has no numbers.
    """
    try:
        content = _ArrayUnpickler(io.BytesIO(read_bytes(request.path))).load()
    except ConfigError:
        raise
    except pickle.UnpicklingError as error:
        # The unpickler names the class that it did not make.
        known = f"has the object {error}" if "." in str(error) and " " not in str(error) else "is damaged"
        raise ConfigError(
            f"{known}; only arrays, lists and mappings are read, as other pickles may execute code: "
            f"save it as CSV, Parquet or NPZ",
            where=request.name,
        ) from None
    except Exception:  # damaged opcodes raise errors of many kinds
        raise ConfigError("is not a pickle, or is damaged", where=request.name) from None
    columns = vectors(content)
    if not columns:
        raise ConfigError("has no vectors of numbers", where=request.name)
    return Table(request.name, list(columns), columns)
