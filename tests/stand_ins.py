"""Stand-ins for a vehicle, props and a world, for tests of drivers and scans without a plant."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from pydrake.math import RigidTransform

from mirdrake.controllers.ackermann import AxleGeometry


@dataclass
class CarStandIn:
    geometry: AxleGeometry = field(default_factory=lambda: AxleGeometry(2.6, 1.5, 1.5, 1.5, 0.6, 0.5))


@dataclass
class PropStandIn:
    name: str
    footprint: Any
    bottom: float = 0.0
    top: float = 1.0
    static: bool = True
    X_WP: RigidTransform = field(default_factory=RigidTransform)
    prop: Any = field(default_factory=lambda: SimpleNamespace(driven_over=False))

    def between(self, low: float, high: float) -> tuple[Any, ...]:
        return (self.footprint,) if self.top > low and self.bottom < high else ()


@dataclass
class WorldStandIn:
    props: list[PropStandIn] = field(default_factory=list)
    tracks: dict[str, Any] = field(default_factory=dict)
