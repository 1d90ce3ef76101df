"""What a worker needs besides the modules of its work; the server imports this module first, once for all workers.

Machine code comes from a cache, but Numba imports its whole library before it reads the first. Garbage collection is
switched off until a worker takes its calls (:func:`mirdrake.execution.workers.serve`): imported objects stay, and
visiting them again and again takes a third of the time of the imports.
"""

import gc

gc.disable()

from numba.core.registry import cpu_target  # noqa: E402 - without garbage collection
from numba.core.runtime import rtsys  # noqa: E402

# As before reading machine code from the cache; what is loaded is not loaded again.
rtsys.initialize(cpu_target.target_context)
