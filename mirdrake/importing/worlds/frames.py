"""Named frames of a world and its models, each counted from another one, and their poses once all are known."""

from dataclasses import dataclass

from pydrake.math import RigidTransform

from mirdrake.core.errors import ModelError

WORLD = ""
"""Name of the frame of the world."""


@dataclass
class Frame:
    """A frame A.

    Attributes:
        X: its pose in the frame it counts from.
        base: full name of that frame.
        where: ``file:line``.
        placed: full name of a frame within A that X is meant for instead of A itself; "" for A.
    """

    X: RigidTransform
    base: str
    where: str
    placed: str = ""


class Frames:
    """Frames by full name, nested ones joined with ``::``."""

    def __init__(self) -> None:
        self._frames: dict[str, Frame] = {}
        self._poses: dict[str, RigidTransform] = {WORLD: RigidTransform()}

    def __contains__(self, name: str) -> bool:
        return name == WORLD or name in self._frames

    def add(self, name: str, frame: Frame) -> None:
        """Take in a frame.

        Raises:
            ModelError: there is one of that name.
        """
        if name in self:
            raise ModelError(f"{frame.where}: the name '{name}' stands here again; names must differ")
        self._frames[name] = frame

    def set(self, name: str, X_WA: RigidTransform) -> None:
        """Say where a frame is in the world, whatever it counted from."""
        where = self._frames[name].where if name in self._frames else ""
        self._frames[name] = Frame(X_WA, WORLD, where)
        self._poses = {WORLD: RigidTransform()}

    def pose(self, name: str, *, where: str = "") -> RigidTransform:
        """Pose of a frame in the world.

        Args:
            name: full name.
            where: put before the message if there is no such frame.

        Raises:
            ModelError: it does not exist, or counts from itself.
        """
        if name not in self._poses:
            trail = [name]
            while trail[-1] not in self._poses:
                trail.append(self._frame(trail[-1], where).base)
                if trail[-1] in trail[:-1]:
                    raise ModelError(f"{self._frames[name].where or where}: frame '{name}' counts from itself")
            X = self._poses[trail[-1]]
            for step in reversed(trail[:-1]):
                X = self._poses[step] = X @ self._local(step, where, depth=0)
        return self._poses[name]

    def _frame(self, name: str, where: str) -> Frame:
        if name not in self._frames:
            raise ModelError(f"{where}: frame '{name}' does not exist")
        return self._frames[name]

    def _local(self, name: str, where: str, depth: int) -> RigidTransform:
        """Pose of a frame in the one it counts from."""
        frame = self._frame(name, where)
        if not frame.placed:
            return frame.X
        X = RigidTransform()  # of the placement frame in this one
        step = frame.placed
        for _ in range(len(self._frames) + 1):
            if step == name:
                return frame.X @ X.inverse()
            if step == WORLD or depth > 20:
                break
            X = self._local(step, frame.where, depth + 1) @ X
            step = self._frame(step, frame.where).base
        raise ModelError(f"{frame.where}: placement frame '{frame.placed}' is not part of '{name}'")
