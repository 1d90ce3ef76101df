"""Contact models of wheels and ground."""

from typing import Literal

ContactModel = Literal["hydroelastic", "point", "tyre"]

STUDY_CONTACT: ContactModel = "tyre"
"""Contact of everything that builds its own plant: manoeuvres, validation, tuning, identification, cases of worlds, the
cockpit. The vertical tyre is of second order in the time step, and its plant needs no contact solver. Diagrams have
hydroelastic contact by default, with which props and vehicles also collide on patches."""
