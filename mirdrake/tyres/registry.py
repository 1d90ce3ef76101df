"""Registry of the kinds of tyres: the only list of them."""

from typing import Annotated

from mirdrake.core.kinds import SelectedByKind
from mirdrake.tyres.base import Tyres
from mirdrake.tyres.brush import BrushTyres
from mirdrake.tyres.coulomb import CoulombTyres
from mirdrake.tyres.magic_formula_tyres import MagicFormulaTyres

TYRES: dict[str, type[Tyres]] = {
    "coulomb": CoulombTyres,
    "brush": BrushTyres,
    "magic_formula": MagicFormulaTyres,
}
"""Classes by ``tyres.kind`` of vehicle.yaml."""

TyreSpec = Annotated[Tyres, SelectedByKind(TYRES, default="coulomb")]
"""Tyres of a vehicle; the default kind is coulomb."""


def kinds_with_slip() -> list[str]:
    """Return the kinds of tyres with slip."""
    return [kind for kind, tyres in TYRES.items() if tyres.has_slip]
