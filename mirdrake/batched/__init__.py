"""Many cars of the single-track model at once: stepping, manoeuvres and control in compiled loops over arrays."""

from typing import TYPE_CHECKING

from mirdrake.batched.cars import STEP, Batch, batch
from mirdrake.batched.ground import Ground
from mirdrake.batched.records import BatchRun
from mirdrake.core.deferred import defer

if TYPE_CHECKING:
    from mirdrake.batched.control import BatchControl as BatchControl
    from mirdrake.batched.path import PathDriver as PathDriver

__all__ = ["STEP", "Batch", "BatchControl", "BatchRun", "Ground", "PathDriver", "batch"]

# These need Drake's plant, batches do not.
__getattr__ = defer(__name__, {"BatchControl": "control", "PathDriver": "path"})
