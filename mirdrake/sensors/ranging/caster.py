"""Base of laser, radar and sonar: rays cast from a moving frame, and the readings of their hits."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context, DiscreteValues

from mirdrake.actors.traffic import PLANAR
from mirdrake.core.leaf_system import LeafSystem
from mirdrake.sensors.noise import sample_noise, substream
from mirdrake.sensors.ranging.faces import Array
from mirdrake.sensors.ranging.motion import NUMBERS, BodyState, body_state
from mirdrake.sensors.ranging.mount import Ranging
from mirdrake.sensors.ranging.world import Beams, Hits, RayWorld
from mirdrake.sensors.sampling import mount_pose


class Caster:
    """Rays of a sensor into the world; declares the inputs and states that they need on the sensor's system.

    The poses of bodies at the sample before are a discrete state of the system, so that beams of a rotating sensor are
    cast from the pose that it had when they left.

    Args:
        system: system of the sensor; receives the inputs ``body_poses``, ``body_spatial_velocities`` and, in a world
            with actors, ``actor_states``, and a state.
        world: surfaces that give returns.
        frame: frame of the sensor, x ahead, z up; fixed to a body.
        mount: rate, limits and noise.
        beams: beams in that frame.
        stream: stream of random numbers.
        hidden: bodies that give no returns.
        ground: whether the ground gives returns.
    """

    def __init__(
        self,
        system: LeafSystem,
        world: RayWorld,
        frame: Frame,
        mount: Ranging,
        beams: Beams,
        *,
        stream: int = 0,
        hidden: tuple[int, ...] = (),
        ground: bool = True,
    ) -> None:
        self.world, self.beams, self.rate = world, beams, mount.rate
        self._mount, self._ground, self._stream = mount, ground, stream
        body, self.X_BS = mount_pose(frame)
        self.carrier = int(body.index())
        self._movers = world.movers(hidden)
        # The layout of the stored states follows this order; a visible carrier is stored once.
        self._bodies = list(dict.fromkeys([self.carrier, *self._movers]))
        self._rolling = bool(beams.times.any())
        self._poses = system.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self._velocities = system.DeclareAbstractInputPort(
            "body_spatial_velocities", AbstractValue.Make([SpatialVelocity.Zero()])
        )
        self._actors = None
        if world.actors:
            self._actors = system.DeclareVectorInputPort("actor_states", len(PLANAR) * world.actors)
        self._before = None
        if self._rolling:
            # -inf as the time of the stored states: none are known yet.
            self._before = system.DeclareDiscreteState(np.full(1 + NUMBERS * len(self._bodies), -np.inf))

    def states(self, context: Context) -> dict[int, BodyState]:
        """Return the present poses and velocities of the carrier and of all visible bodies, by body.

        Poses of the plant lead its velocities by half a step and are moved back, as in the ground truth.
        """
        poses, velocities = self._poses.Eval(context), self._velocities.Eval(context)
        states = {
            body: BodyState(
                poses[body].rotation().matrix(),
                poses[body].translation(),
                velocities[body].rotational(),
                velocities[body].translational(),
            ).back(self.world.lead)
            for body in self._bodies
            if body < self.world.bodies
        }
        # Actors are not bodies of the plant; their numbers follow those of the bodies.
        if self._actors is not None:
            rows = self._actors.Eval(context).reshape(-1, len(PLANAR))
            states |= dict(enumerate(self.world.actor_states(rows), start=self.world.bodies))
        return states

    def look(self, context: Context, states: dict[int, BodyState] | None = None) -> Hits:
        """Return the hits of the scan that is complete now."""
        now = self.states(context) if states is None else states
        before: dict[int, BodyState] = {}
        if self._before is not None:
            numbers = context.get_discrete_state(self._before).get_value()
            # States of another time (first sample, changed Context) must not be interpolated.
            if abs(context.get_time() - 1.0 / self.rate - numbers[0]) < 1e-6:
                rows = numbers[1:].reshape(-1, NUMBERS)
                before = {body: body_state(row) for body, row in zip(self._bodies, rows, strict=True)}
        return self.world.cast(
            self.beams,
            self.X_BS,
            (before.get(self.carrier), now[self.carrier]),
            {body: (before.get(body), now[body]) for body in self._movers},
            period=1.0 / self.rate,
            far=self._mount.far,
            ground=self._ground,
        )

    def keep(self, context: Context, state: DiscreteValues) -> None:
        """Store the present poses and velocities for the next sample."""
        if self._before is not None:
            now = [body.numbers() for body in self.states(context).values()]
            state.get_mutable_vector(self._before).SetFromVector(np.concatenate(([context.get_time()], *now)))

    def reading(self, distance: Array, index: int) -> Array:
        """Return the readings of distances (...) [m] at a sample number: limits, noise, resolution, lost beams.

        Whether there is a return depends on the true distance; the reading then stays within the limits.
        """
        mount = self._mount
        # Limits apply to the true distance: noise must not create or remove returns at the limits.
        seen = (distance >= mount.near) & (distance <= mount.far)
        if not (mount.noise or mount.resolution or mount.lost_beams):
            return np.where(seen, distance, np.inf)
        generator = sample_noise(substream(self._stream, "beams"), index)
        if mount.lost_beams:
            seen &= generator.random(distance.shape) >= mount.lost_beams
        values = distance
        if mount.noise:
            values = values + mount.noise * generator.standard_normal(distance.shape)
        if mount.resolution:
            values = mount.resolution * np.rint(values / mount.resolution)
        return np.where(seen, np.clip(values, mount.near, mount.far), np.inf)
