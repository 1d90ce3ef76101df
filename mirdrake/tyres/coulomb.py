"""Tyres without a tyre law: the contact's Coulomb friction."""

from typing import Literal

from mirdrake.tyres.base import Tyres


class CoulombTyres(Tyres):
    """Tyre forces come from the contact's Coulomb friction alone; plus rolling resistance."""

    kind: Literal["coulomb"] = "coulomb"
