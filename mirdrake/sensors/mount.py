"""Base of the kinds of sensors: the data of a mount, and the system that it makes."""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from pydrake.systems.framework import System

from mirdrake.vehicles.mount import Mount

if TYPE_CHECKING:
    from mirdrake.plant.plant import PlantParts, VehicleInPlant


class SensorMount(Mount, ABC):
    """Mount of a sensor that can be simulated."""

    @abstractmethod
    def make(self, *, parts: "PlantParts", part: "VehicleInPlant", stream: int) -> System:
        """Return the system of the sensor.

        Args:
            parts: plant, scene graph and world.
            part: the vehicle.
            stream: stream of random numbers, from :func:`mirdrake.sensors.noise.noise_stream`.

        Raises:
            MissingDependencyError: a package that this kind needs is not installed.
        """
