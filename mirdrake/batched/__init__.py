"""Many cars of the single-track model at once: stepping, manoeuvres and control in compiled loops over arrays."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mirdrake.batched.cars import STEP, Batch, batch
from mirdrake.batched.ground import Ground
from mirdrake.batched.records import BatchRun

if TYPE_CHECKING:
    from mirdrake.batched.control import BatchControl as BatchControl
    from mirdrake.batched.path import PathDriver as PathDriver

__all__ = ["STEP", "Batch", "BatchControl", "BatchRun", "Ground", "PathDriver", "batch"]

_LATER = {"BatchControl": "mirdrake.batched.control", "PathDriver": "mirdrake.batched.path"}


def __getattr__(name: str) -> Any:
    """Load a class when it is first used (PEP 562): these need Drake's plant, batches do not."""
    if name not in _LATER:
        raise AttributeError(f"module 'mirdrake.batched' has no attribute '{name}'")
    return getattr(import_module(_LATER[name]), name)
