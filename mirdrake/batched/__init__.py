"""Many cars of the single-track model at once: stepping, manoeuvres and control in compiled loops over arrays."""

from typing import TYPE_CHECKING, Any

from mirdrake.batched.cars import STEP, Batch, batch
from mirdrake.batched.ground import Ground
from mirdrake.batched.records import BatchRun

if TYPE_CHECKING:
    from mirdrake.batched.control import BatchControl as BatchControl

__all__ = ["STEP", "Batch", "BatchControl", "BatchRun", "Ground", "batch"]


def __getattr__(name: str) -> Any:
    """Load BatchControl when it is first used (PEP 562): it needs Drake's plant, batches do not."""
    if name != "BatchControl":
        raise AttributeError(f"module 'mirdrake.batched' has no attribute '{name}'")
    from mirdrake.batched.control import BatchControl

    return BatchControl
