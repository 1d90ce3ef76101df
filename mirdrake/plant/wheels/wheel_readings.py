"""Measured loads of the wheels of all vehicles, and contacts of their other parts."""

from collections.abc import Collection, Sequence

from pydrake.common.value import AbstractValue
from pydrake.geometry import GeometryId
from pydrake.multibody.plant import ContactResults
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import Signal, declare_state_output
from mirdrake.plant.plant import VehicleInPlant
from mirdrake.vehicles import WHEELS

LOAD_PERIOD = 0.1
"""Sufficient period of measurement for Coulomb tyres in point contact [s], whose loads follow the compression."""


class WheelReadings(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Measured wheel loads of all vehicles, and contacts of their other parts.

    Input ports:
        contact_results: the plant's contact results (abstract).
    Output ports:
        wheel_load (4 a vehicle) [N]: normal loads, measured every `period`; only if this system measures.
        other_contacts (1) [1]: number of contacts of vehicles that are not tyres on the road, updated every `period`.

    Args:
        vehicles: the vehicles.
        measures: whether Drake's contact bears the wheels.
        ground: geometries of the road.
        scenery: geometries of the world; their contacts with each other are ignored.
        period: time between two readings of the contact results [s], a multiple of the plant's step.
    """

    def __init__(
        self,
        vehicles: Sequence[VehicleInPlant],
        *,
        measures: bool,
        ground: Collection[GeometryId],
        scenery: Collection[GeometryId],
        period: float,
    ) -> None:
        super().__init__()
        names = [part.name for part in vehicles]
        self._ground, self._scenery = frozenset(ground), frozenset(scenery) | frozenset(ground)
        # Without a row, a contact of a wheel counts as one of other parts.
        tyres = [tyre for part in vehicles for tyre in part.tyres] if measures else []
        self._row = {tyre: index for index, tyre in enumerate(tyres)}
        self.contact_results = self.DeclareAbstractInputPort("contact_results", AbstractValue.Make(ContactResults()))
        self._others, self._loads = self.DeclareDiscreteState(1), self.DeclareDiscreteState(len(tyres))
        loads = [Signal(f"{name}.wheel_load.{wheel}", "N", "normal load") for name in names for wheel in WHEELS]
        others = [Signal("other_contacts", "", "contacts that are not tyres on the road")]
        self.other_contacts = declare_state_output(self, "other_contacts", others, self._others)
        self.wheel_load = declare_state_output(self, "wheel_load", loads, self._loads) if measures else None
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        # Contact results are those of the step that has just been solved.
        results = self.contact_results.Eval(context)
        loads, others = [0.0] * len(self._row), 0
        # The ground is level where Drake's contact bears the wheels, so the load is the vertical force.
        contacts = []
        for k in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(k)
            pair = info.point_pair()
            contacts.append((pair.id_A, pair.id_B, info.contact_force()[2]))
        for k in range(results.num_hydroelastic_contacts()):
            patch = results.hydroelastic_contact_info(k)
            surface = patch.contact_surface()
            contacts.append((surface.id_M(), surface.id_N(), patch.F_Ac_W().translational()[2]))
        for first, second, force in contacts:
            wheel = self._row.get(second) if first in self._ground else self._row.get(first)
            if wheel is not None and (first in self._ground or second in self._ground):
                loads[wheel] += abs(float(force))  # the sign depends on which of the two geometries is A
            elif not (first in self._scenery and second in self._scenery):
                others += 1
        state.get_mutable_value(self._loads)[:] = loads
        state.get_mutable_value(self._others)[:] = others
