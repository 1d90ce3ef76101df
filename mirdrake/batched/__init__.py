"""Many cars of the single-track model at once: stepping, manoeuvres and control in compiled loops over arrays."""

from mirdrake.batched.cars import STEP, Batch, batch
from mirdrake.batched.control import BatchControl
from mirdrake.batched.ground import Ground
from mirdrake.batched.records import BatchRun

__all__ = ["STEP", "Batch", "BatchControl", "BatchRun", "Ground", "batch"]
