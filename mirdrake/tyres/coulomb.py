"""Tyres with Coulomb friction: a stiff brush.

Slip stays small up to the friction limit, and a standing tyre sticks. Forces and stiffnesses are proportional to the
load. The pivoting moment is in :mod:`mirdrake.plant.wheels.step`.
"""

from typing import Literal

from mirdrake.tyres.base import SteadyLaw, TyreAtLoad, TyreLaw, Tyres
from mirdrake.tyres.brush import BrushCurve, brush_on
from mirdrake.tyres.relaxation import Contact

STIFFNESS = 150.0
"""Slip stiffness of the brush over its load [1]; tyres have 10 to 30. At a lateral acceleration of 5 m/s² the slip
angle is 0.2 degrees."""

PIVOT_STIFFNESS = 30.0
"""Slip stiffness over the load for the pivoting moment [1], that of a tyre: a rolling patch bends along a curve."""

LENGTH = 0.5
"""Relaxation length of the brush [m]. At standstill the tyre is a spring of stiffness C / σ; a vehicle oscillates on it
with √(g C / (N σ)) = 54 rad/s, for which steps of 20 ms are stable."""

PIVOT_LENGTH = 0.25
"""Relaxation length of the pivoting moment [m]: a patch takes up a turn within about its own length."""

DAMPING = 1.5
"""Damping of the brush at all speeds over its load [s/m]. A wheel of inertia I and radius R would oscillate on the
brush above walking pace, and control loops of its spin would excite this. Critical damping is 2 √(I C / σ) / R: 1.8 s/m
times the load for a car, 2.3 s/m for a robot of 44 kg."""


class CoulombTyres(Tyres):
    """Tyres with Coulomb friction and rolling resistance only."""

    kind: Literal["coulomb"] = "coulomb"


COULOMB_LAW = SteadyLaw(BrushCurve, brush_on)
"""Law of the stiff brush."""


def make_coulomb_law(friction: float, reference: float) -> TyreLaw:
    """Return Coulomb friction as a tyre law.

    Args:
        friction: coefficient of the tyre; the smaller one of tyre and ground holds.
        reference: coefficient of the ground that the argument `friction` of the law is relative to.
    """

    def law(load: float, inclination: float, relative: float) -> TyreAtLoad:  # noqa: ARG001 - no camber
        limit, stiffness = min(friction, relative * reference) * load, STIFFNESS * load
        contact = Contact(stiffness, stiffness, LENGTH, LENGTH, limit, limit)
        return TyreAtLoad(contact, BrushCurve(stiffness, stiffness, limit, 0.0), COULOMB_LAW)

    return law
