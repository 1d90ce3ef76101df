"""The single-track model as a Drake system, for double, AutoDiffXd and symbolic Expression."""

import sys
from collections.abc import Callable
from dataclasses import replace
from math import pi, remainder
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector_, Context, LeafSystem_, OutputPort
from pydrake.systems.scalar_conversion import TemplateSystem

from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.leaf_system import declare_cached_value, freeable
from mirdrake.core.maths import tan
from mirdrake.core.signals import Signals, declare_vector_input, declare_vector_output
from mirdrake.core.vectors import STATE
from mirdrake.single_track.dynamics import CompiledEquations, Variant, evaluate
from mirdrake.single_track.parameters import PARAMETERS, SingleTrackParameters
from mirdrake.single_track.signals import FORCES, MOTION, STEERING


# Its complexity is the sum of the methods of the class, which are short; the class must be made within the function.
# Without a scope Drake looks for this module in the source of all frames of the stack, which takes 0.1 s.
@TemplateSystem.define("SingleTrack_", scope=sys.modules[__name__])  # type: ignore[untyped-decorator, unused-ignore]
def SingleTrack_(T: type) -> Any:  # noqa: N802
    """Return the class of single-track models for a scalar type; ``SingleTrack`` is that for floats.

    The class is defined in this function because Drake's scalar conversion makes one class per type.
    """
    plain = T is float

    class Impl(freeable(LeafSystem_[T])):  # type: ignore[misc, unused-ignore]
        """Single-track model of a vehicle; equations in :mod:`mirdrake.single_track.dynamics`.

        Input ports:
            steering (1) [rad]: bicycle steering angle; with actuators (2) [rad, rad/s]: set-point and its rate.
            forces (2) [N]: drive and brake force; with actuators (3) [N, N, m/s]: also the set-point of the speed.
        Output ports:
            state (12) [m, rad, m/s, rad/s]: as the ground truth of the full vehicle, of the rear axle's centre; z, roll
                and pitch are zero: the model stays on the plane of the road.
            motion (7): :data:`MOTION`.
            steering_angle (1) [rad]: the state; only with actuators.

        Continuous state: :attr:`Variant.state_names`; x, y, yaw of the rear axle's centre, vx, vy at the centre of
            mass.
        Parameter 0 of the Context: :class:`SingleTrackParameters`, in its order.

        Args:
            parameters: the defaults of a Context.
            variant: choice of the equations.

        Raises:
            ConfigError: unknown tyres, or relaxation or roll without tyres.
        """

        def _construct(
            self, parameters: SingleTrackParameters, variant: Variant | None = None, *, converter: Any = None
        ) -> None:
            super().__init__(converter)
            variant = variant or Variant()
            variant.check()
            self.parameters, self.variant = parameters, variant
            self.state_names = variant.state_names
            self._roll_index = self.state_names.index("roll") if variant.roll else 0
            self.set_name("single_track")
            servo = int(variant.actuators)
            # Actuators add an input to both ports: the rate of the steering set-point and the set-point of the speed.
            self.steering = declare_vector_input(self, "steering", STEERING[: 1 + servo])
            self.forces = declare_vector_input(self, "forces", FORCES[: 2 + servo])
            self.DeclareContinuousState(len(self.state_names))
            self._parameters = self.DeclareNumericParameter(BasicVector_[T](parameters.values()))
            # Compiled equations take floats only; AutoDiffXd and Expression use the same equations in Python.
            if plain:
                self._equations = CompiledEquations(variant)
                # Parameters and inputs change rarely in a run: Drake's cache converts them once, not in each integrator
                # stage.
                needs = {self.all_parameters_ticket()}
                self._record = declare_cached_value(self, "parameters", Value[object], self._read_parameters, needs)
                needs = {self.steering.ticket(), self.forces.ticket()}
                self._held = declare_cached_value(self, "inputs", Value[object], self._read_inputs, needs)

            # Without direct feedthrough the state can be connected to a controller without an algebraic loop.
            needs = {self.xc_ticket(), self.all_parameters_ticket()}
            # The yaw rate of the kinematic model is a function of the steering input, which makes a feedthrough.
            if variant.tyres == "kinematic" and not variant.actuators:
                needs.add(self.steering.ticket())
            self.state = self._declare("state", STATE, self._calc_state, needs)
            if variant.actuators:
                angle = self._declare("steering_angle", STEERING[:1], self._calc_steering, {self.xc_ticket()})
                self.steering_angle = angle
            self.motion = self._declare("motion", MOTION, self._calc_motion, {self.all_sources_ticket()})

        def _declare(self, name: str, contents: Signals, calc: Callable[..., None], needs: set[Any]) -> OutputPort:
            # Drake's own declaration for other scalar types: names and units of the signals are for floats only.
            if plain:
                return declare_vector_output(self, name, contents, calc, prerequisites=needs)
            return self.DeclareVectorOutputPort(name, len(contents), calc, prerequisites_of_calc=needs)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(self, other.parameters, other.variant, converter=converter)

        def DoCalcTimeDerivatives(self, context: Context, derivatives: Any) -> None:  # noqa: N802
            if plain:
                rates, _ = self._evaluate_compiled(context)
            else:
                rates = self._evaluate(context).state
            derivatives.get_mutable_vector().SetFromVector(rates)

        def _read_parameters(self, context: Context, record: Any) -> None:
            values = context.get_numeric_parameter(self._parameters).CopyToVector()
            record.set_value(self._equations.parameters(values))

        def _read_inputs(self, context: Context, record: Any) -> None:
            record.set_value(self._equations.inputs(self._inputs(context)))

        def _evaluate_compiled(self, context: Context) -> tuple[Any, Any]:
            x = context.get_continuous_state_vector().CopyToVector()
            return self._equations(self._record.evaluate(context), x, self._held.evaluate(context))

        def _inputs(self, context: Context) -> list[Any]:
            steering, forces = self.steering.Eval(context).tolist(), self.forces.Eval(context).tolist()
            u = [steering[0], forces[0], forces[1]]
            return [*u, steering[1], forces[2]] if self.variant.actuators else u

        def _evaluate(self, context: Context) -> Any:
            x = context.get_continuous_state_vector().CopyToVector()
            p = context.get_numeric_parameter(self._parameters).CopyToVector()
            return evaluate(self.variant, p, x, self._inputs(context))

        def _calc_state(self, context: Context, output: Any) -> None:
            x = context.get_continuous_state_vector().CopyToVector().tolist()
            p = context.get_numeric_parameter(self._parameters)
            zero = T(0.0)
            if self.variant.tyres == "kinematic":
                # p[2] and p[3] are front_length and rear_length, in the order of PARAMETERS.
                delta = x[-1] if self.variant.actuators else self.steering.Eval(context)[0]
                vy, spin = zero, x[3] * tan(delta) / (p[2] + p[3])
            else:
                # From the centre of mass to the rear axle: vy - b r.
                vy, spin = x[4] - p[3] * x[5], x[5]
            yaw = remainder(x[2], 2.0 * pi) if plain else x[2]  # in [-pi, pi], as the full vehicle's
            roll, roll_rate = (x[self._roll_index], x[self._roll_index + 1]) if self.variant.roll else (zero, zero)
            output.SetFromVector([x[0], x[1], zero, roll, zero, yaw, x[3], vy, zero, roll_rate, zero, spin])

        def _calc_steering(self, context: Context, output: Any) -> None:
            output.SetFromVector([context.get_continuous_state_vector().CopyToVector()[-1]])

        def _calc_motion(self, context: Context, output: Any) -> None:
            if plain:
                output.SetFromVector(self._evaluate_compiled(context)[1])
            else:
                zero = T(0.0)  # converts floats to T
                output.SetFromVector([zero + value for value in self._evaluate(context).motion])

        def set_parameters(self, context: Context, **changes: Any) -> None:
            """Change parameters of a Context by name.

            Floats are checked as in :class:`SingleTrackParameters`; AutoDiffXd and Expression are not checked.

            Raises:
                ConfigError: unknown parameter, or a value out of range.
            """
            for name in changes:
                if name not in PARAMETERS:
                    raise ConfigError(f"SingleTrack: no parameter '{name}'; {did_you_mean(name, PARAMETERS)}")
            if plain:
                values: Any = replace(self.get_parameters(context), **changes).values()
            else:
                # AutoDiff and symbolic values have no plain vector; their elements are changed one by one.
                values = context.get_numeric_parameter(self._parameters).CopyToVector()
                for name, value in changes.items():
                    values[PARAMETERS.index(name)] = value
            context.get_mutable_numeric_parameter(self._parameters).SetFromVector(values)

        def get_parameters(self, context: Context) -> SingleTrackParameters:
            """Return the parameters in a Context; floats only."""
            values = context.get_numeric_parameter(self._parameters).CopyToVector().tolist()
            return SingleTrackParameters(**dict(zip(PARAMETERS, values, strict=True)))

        def set_state(self, context: Context, **values: Any) -> None:
            """Set the state by name; other states are zero.

            Raises:
                ConfigError: unknown state.
            """
            x = np.array([T(0.0)] * len(self.state_names))
            for name, value in values.items():
                if name not in self.state_names:
                    raise ConfigError(f"SingleTrack: no state '{name}'; {did_you_mean(name, self.state_names)}")
                x[self.state_names.index(name)] = value
            context.SetContinuousState(x)

    return Impl


SingleTrack: Any = SingleTrack_[None]
