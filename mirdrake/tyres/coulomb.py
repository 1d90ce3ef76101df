"""Tyres without a tyre law: Coulomb friction.

In Drake's contact its friction is that of the contact. Where tyres touch the ground themselves (`plant.contact: tyre`),
Coulomb friction is a stiff brush: slip stays small up to the friction limit, and a standing tyre sticks.
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

LENGTH = 0.25
"""Relaxation length of the brush [m]. At standstill the tyre is a spring of stiffness C / σ; a vehicle oscillates on it
with √(g C / (N σ)) = 77 rad/s, for which steps of 20 ms are stable."""

DAMPING = 2.5
"""Damping of the brush at all speeds over its load [s/m]. A wheel of inertia I and radius R would oscillate on the
brush above walking pace, and control loops of its spin would excite this. Critical damping is 2 √(I C / σ) / R: 2.6 s/m
times the load for a car, 3.3 s/m for a robot of 44 kg."""


class CoulombTyres(Tyres):
    """Tyres with Coulomb friction of the contact and rolling resistance only."""

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
