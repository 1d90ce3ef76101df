"""Locked and limited-slip differentials: a system between the powertrain and the tyres.

The open differential of :mod:`mirdrake.plant.powertrain.law` gives both wheels the same torque. Clutches, or the
friction of gears, transmit a torque M from the faster to the slower wheel in addition::

    T_left = T / 2 - M,    T_right = T / 2 + M,    2 |M| <= locking(T)

Below the limit the wheels turn together, apart from the twist θ of the half shafts: M = k θ + c (ω_left - ω_right). At
the limit the coupling slides, and the twist is that of the limit. This is Coulomb friction behind a spring, so that
locking, sliding and sticking need no cases, and the locked differential is the one without a limit.

The coupling is evaluated in each step of the plant, with the twist at its end (semi-implicit Euler).
"""

from math import sqrt
from typing import TYPE_CHECKING, NamedTuple

from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import declare_vector_input, declare_vector_output
from mirdrake.core.yaml_io import where
from mirdrake.plant.powertrain.system import WHEEL_TORQUE, wheel_inertias
from mirdrake.vehicles.differential_spec import Differential, OpenDifferential

if TYPE_CHECKING:
    from mirdrake.plant.plant import VehicleInPlant

MAX_RATE = 1.0
"""Largest product of the time step and the natural frequency of two wheels against each other [1]; the integration is
unstable above about 1.5."""

_DAMPING_RATIO = 0.3  # of the same oscillation, without tyres


class Coupling(NamedTuple):
    """Coupling of the two wheels of an axle.

    Attributes:
        kind: its law.
        stiffness: of the half shafts [N m/rad].
        damping: the same [N m s/rad].
    """

    kind: Differential
    stiffness: float
    damping: float


def couple(coupling: Coupling, twist: float, slip: float, torque: float, period: float) -> tuple[float, float]:
    """Advance a coupling by one step.

    Args:
        coupling: its parameters.
        twist: twist of the half shafts at the beginning of the step [rad].
        slip: spin rate of the left wheel less that of the right wheel [rad/s].
        torque: torque of the axle [N m], positive where it accelerates the vehicle.
        period: length of the step [s].

    Returns:
        The twist at the end of the step [rad], and the torque from the left to the right wheel [N m].
    """
    twist += period * slip
    moment = coupling.stiffness * twist + coupling.damping * slip
    limit = 0.5 * coupling.kind.locking(torque)
    if abs(moment) > limit:
        # It slides: the twist is the one that causes the limit.
        moment = limit if moment > 0.0 else -limit
        twist = (moment - coupling.damping * slip) / coupling.stiffness
    return twist, moment


class DifferentialCoupling(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Differentials of a vehicle that are not open.

    Input ports:
        torque (8) [N m]: torques of the powertrain, :data:`mirdrake.plant.powertrain.system.WHEEL_TORQUE`.
        plant_state: the plant's state, positions and velocities.
    Output ports:
        wheel_torque (8) [N m]: the same for the tyres, with the torques between the wheels.

    Args:
        plant: the finalised plant.
        part: the vehicle in it.

    Raises:
        ConfigError: a coupling is too stiff for the time step of the plant.
    """

    def __init__(self, plant: MultibodyPlant, part: "VehicleInPlant") -> None:
        super().__init__()
        self._period = part.period
        self._couplings = make_couplings(plant, part)
        self._spins = [plant.num_positions() + joint.velocity_start() for joint in part.wheels]
        self.torque = declare_vector_input(self, "torque", WHEEL_TORQUE)
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self._twist = self.DeclareDiscreteState(2)
        self.wheel_torque = declare_vector_output(self, "wheel_torque", WHEEL_TORQUE, self._calc)
        self.DeclarePeriodicDiscreteUpdateEvent(self._period, 0.0, self._update)

    def _step(self, context: Context) -> tuple[list[float], list[float]]:
        """Return the twists at the end of the step, and the torques between the wheels of both axles."""
        x, torques = self.plant_state.Eval(context), self.torque.Eval(context)
        twists = context.get_discrete_state(self._twist).value().tolist()
        moments = [0.0, 0.0]
        for axle, coupling in enumerate(self._couplings):
            if coupling is None:
                continue
            left, right = 2 * axle, 2 * axle + 1
            slip = float(x[self._spins[left]] - x[self._spins[right]])
            twists[axle], moments[axle] = couple(
                coupling, twists[axle], slip, float(torques[left] + torques[right]), self._period
            )
        return twists, moments

    def _update(self, context: Context, state: DiscreteValues) -> None:
        state.set_value(self._twist, self._step(context)[0])

    def _calc(self, context: Context, output: BasicVector) -> None:
        front, rear = self._step(context)[1]
        torques = self.torque.Eval(context).copy()
        torques[:4] += (-front, front, -rear, rear)
        output.SetFromVector(torques)


def make_couplings(plant: MultibodyPlant, part: "VehicleInPlant") -> tuple[Coupling | None, Coupling | None]:
    """Return the couplings of the front and the rear axle; None for an open differential.

    Raises:
        ConfigError: a coupling is too stiff for the time step of the plant.
    """
    spec = part.vehicle.spec
    inertias = wheel_inertias(plant, part)
    couplings: list[Coupling | None] = []
    for name, first in (("front", 0), ("rear", 2)):
        kind = getattr(spec.powertrain.differential, name)
        if isinstance(kind, OpenDifferential):
            couplings.append(None)
            continue
        # Two wheels against each other: 1/I = 1/I_left + 1/I_right.
        inertia = 1.0 / (1.0 / inertias[first] + 1.0 / inertias[first + 1])
        limit = inertia * (MAX_RATE / part.period) ** 2
        if kind.stiffness > limit:
            raise ConfigError(
                f"{name}: a stiffness of {kind.stiffness:g} N m/rad is too "
                f"large for steps of {part.period:g} s; at most {limit:.3g} N m/rad, or smaller steps",
                where=where(spec.powertrain, "differential"),
            )
        couplings.append(Coupling(kind, kind.stiffness, 2.0 * _DAMPING_RATIO * sqrt(kind.stiffness * inertia)))
    return couplings[0], couplings[1]
