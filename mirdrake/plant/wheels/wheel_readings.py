"""Contacts of vehicles that are not tyres on the road."""

from collections.abc import Collection, Sequence

from pydrake.common.value import AbstractValue
from pydrake.geometry import GeometryId
from pydrake.multibody.plant import ContactResults
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.core.leaf_system import LeafSystem
from mirdrake.core.signals import Signal, declare_state_output
from mirdrake.plant.plant import VehicleInPlant


class WheelReadings(LeafSystem):  # type: ignore[misc, unused-ignore]
    """Contacts of vehicles that are not tyres on the road.

    Input ports:
        contact_results: the plant's contact results (abstract).
    Output ports:
        other_contacts (1) [1]: number of contacts of vehicles that are not tyres on the road, updated every `period`.

    Args:
        vehicles: the vehicles.
        ground: geometries of the road.
        scenery: geometries of the world; their contacts with each other are ignored.
        period: time between two readings of the contact results [s], a multiple of the plant's step.
    """

    def __init__(
        self,
        vehicles: Sequence[VehicleInPlant],
        *,
        ground: Collection[GeometryId],
        scenery: Collection[GeometryId],
        period: float,
    ) -> None:
        super().__init__()
        # Numbers of geometries: their ids are slower to hash.
        self._ground = frozenset(geometry.get_value() for geometry in ground)
        self._scenery = self._ground | {geometry.get_value() for geometry in scenery}
        self._tyres = frozenset(tyre.get_value() for part in vehicles for tyre in part.tyres)
        self.contact_results = self.DeclareAbstractInputPort("contact_results", AbstractValue.Make(ContactResults()))
        self._others = self.DeclareDiscreteState(1)
        others = [Signal("other_contacts", "", "contacts that are not tyres on the road")]
        self.other_contacts = declare_state_output(self, "other_contacts", others, self._others)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        # Contact results are those of the step that has just been solved.
        results, others = self.contact_results.Eval(context), 0
        pairs = []
        for k in range(results.num_point_pair_contacts()):
            pair = results.point_pair_contact_info(k).point_pair()
            pairs.append((pair.id_A.get_value(), pair.id_B.get_value()))
        for k in range(results.num_hydroelastic_contacts()):
            surface = results.hydroelastic_contact_info(k).contact_surface()
            pairs.append((surface.id_M().get_value(), surface.id_N().get_value()))
        tyres, ground, scenery = self._tyres, self._ground, self._scenery
        for one, other in pairs:
            on_road = (one in tyres and other in ground) or (other in tyres and one in ground)
            others += not on_road and not (one in scenery and other in scenery)
        state.get_mutable_value(self._others)[:] = others
