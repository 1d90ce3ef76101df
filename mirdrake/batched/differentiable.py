"""The single-track model as a function of JAX: gradients by parameters, start and inputs from the same equations."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from mirdrake.batched.cars import STEP
from mirdrake.batched.kernels import runge_kutta
from mirdrake.core.errors import ConfigError
from mirdrake.core.extras import import_extra
from mirdrake.single_track.dynamics import Inputs, State, Variant, flags_of, lateral_force_of
from mirdrake.single_track.parameters import PARAMETERS

Drive = Callable[[Any, Any, Any], Any]
"""(parameters (p), states (s) at the start, inputs (t, u)) -> states (t + 1, s), as arrays of JAX."""


def make_drive(variant: Variant, *, step: float = STEP, hold: int = 1) -> Drive:
    """Return a drive of one car as a function that JAX differentiates, compiles and maps over cars.

    The function takes parameters in the order of :data:`mirdrake.single_track.parameters.PARAMETERS`, states in the
    order of :attr:`Variant.state_names` and inputs in that of :attr:`Variant.input_names`. It is that of
    :meth:`mirdrake.batched.Batch.run` without a ground.

    Args:
        variant: equations.
        step: step of the integration [s].
        hold: number of steps for which each row of inputs is held.

    Raises:
        ConfigError: an unknown variant, or JAX computes in single precision.
        MissingDependencyError: JAX is not installed.
    """
    jax = import_extra("jax", need="gradients need JAX", extra="jax")
    variant.check()
    # The setting is global to JAX and must precede its first array, so it is reported instead of changed here.
    if not jax.config.jax_enable_x64:
        raise ConfigError(
            "JAX computes in single precision, in which positions drift; first call "
            'jax.config.update("jax_enable_x64", True)'
        )
    law, flags = lateral_force_of(variant), flags_of(variant)
    names, inputs_of = variant.state_names, variant.input_names

    def drive(parameters: Any, start: Any, inputs: Any) -> Any:
        numbers, start = jax.numpy.asarray(parameters, dtype=float), jax.numpy.asarray(start, dtype=float)
        inputs = jax.numpy.asarray(inputs, dtype=float)
        # Traced numbers under the names of the record: the equations read both in the same way.
        p = SimpleNamespace(**{name: numbers[k] for k, name in enumerate(PARAMETERS)})
        zero = jax.numpy.zeros(())  # an array, so that the states that the variant does not have are arrays, too

        def advance(row: Any, given: Any) -> tuple[Any, Any]:
            u = Inputs(**dict.fromkeys(Inputs._fields, zero) | {name: given[k] for k, name in enumerate(inputs_of)})

            def once(_: Any, x: Any) -> Any:
                state = State(**dict.fromkeys(State._fields, zero) | {name: x[k] for k, name in enumerate(names)})
                after = runge_kutta(law, flags, p, state, u, step)
                return jax.numpy.stack([getattr(after, name) for name in names])

            # Loops of JAX, not of Python: the graph stays one step long, whatever the number of rows.
            row = jax.lax.fori_loop(0, hold, once, row)
            return row, row

        _, rows = jax.lax.scan(advance, start, inputs)
        return jax.numpy.concatenate((start[None], rows))

    return jax.jit(drive)  # type: ignore[no-any-return, unused-ignore]
