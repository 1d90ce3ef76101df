"""Named frames of models, each relative to another one, and their poses once all frames are known.

Poses follow the SDF specification: those of links, frames and nested models are relative to the model that contains
them, those of shapes to their link, that of a joint to its child link, unless ``relative_to`` names another frame.
"""

from dataclasses import dataclass
from pathlib import Path

from pydrake.math import RigidTransform

from mirdrake.core.errors import ModelError

WORLD = ""
"""Name of the outermost frame: of the world, or of the only model of a file."""


@dataclass
class Frame:
    """A frame A.

    Attributes:
        X: pose of A in the frame `base`.
        base: full name of that frame.
        where: ``file:line``.
        placed: full name of a frame within A whose pose X is instead (``placement_frame``); "" for A itself.
    """

    X: RigidTransform
    base: str
    where: str
    placed: str = ""


@dataclass
class Scope:
    """The model or world that contains an element: prefix of names and frame of poses.

    Attributes:
        prefix: prefix of the names; "" in the outermost model or world.
        origin: full name of the frame that poses are relative to by default.
        version: version of SDF.
        folder: folder of the file.
        files: files that were included on the way here, to find includes of themselves.
    """

    prefix: str
    origin: str
    version: tuple[int, ...]
    folder: Path
    files: tuple[Path, ...]

    def full(self, name: str) -> str:
        """Return the full name of a frame that is named here."""
        if name == "__model__":
            return self.origin
        return WORLD if not self.prefix and name in {"world", "__world__"} else f"{self.prefix}{name}"

    def base(self, name: str) -> str:
        """Return the full name of the frame that a pose is relative to, if its ``relative_to`` is `name` or ""."""
        return self.full(name) if name else self.origin


class Frames:
    """Frames by full name; names of nested models are joined with ``::``."""

    def __init__(self) -> None:
        self._frames: dict[str, Frame] = {}
        self._poses: dict[str, RigidTransform] = {WORLD: RigidTransform()}

    def __contains__(self, name: str) -> bool:
        return name == WORLD or name in self._frames

    def base(self, name: str) -> str | None:
        """Return the full name of the frame that a frame is relative to; None if it does not exist."""
        frame = self._frames.get(name)
        return None if frame is None else frame.base

    def add(self, name: str, frame: Frame) -> None:
        """Add a frame.

        Raises:
            ModelError: there is one of that name.
        """
        if name in self:
            raise ModelError(f"the name '{name}' is used twice; names must differ", where=frame.where)
        self._frames[name] = frame

    def set(self, name: str, X_WA: RigidTransform) -> None:
        """Set the pose of a frame relative to the world."""
        where = self._frames[name].where if name in self._frames else ""
        self._frames[name] = Frame(X_WA, WORLD, where)
        # Any other pose may depend on this one, so that all are computed again.
        self._poses = {WORLD: RigidTransform()}

    def pose(self, name: str, *, where: str = "") -> RigidTransform:
        """Return the pose of a frame in the outermost one.

        Args:
            name: full name.
            where: ``file:line`` for the message if the frame does not exist.

        Raises:
            ModelError: the frame does not exist, or is relative to itself.
        """
        if name not in self._poses:
            # Follow the bases up to a frame with a known pose, then compute the poses on the way back.
            trail = [name]
            while trail[-1] not in self._poses:
                below = self._frames[trail[-2]].where if len(trail) > 1 else where
                trail.append(self._frame(trail[-1], below).base)
                if trail[-1] in trail[:-1]:
                    raise ModelError(f"frame '{name}' is relative to itself", where=self._frames[name].where or where)
            X = self._poses[trail[-1]]
            for step in reversed(trail[:-1]):
                X = self._poses[step] = X @ self._local(step, where, depth=0)
        return self._poses[name]

    def _frame(self, name: str, where: str) -> Frame:
        if name not in self._frames:
            raise ModelError(f"frame '{name}' does not exist", where=where)
        return self._frames[name]

    def _local(self, name: str, where: str, depth: int) -> RigidTransform:
        """Return the pose of a frame in the one it is relative to."""
        frame = self._frame(name, where)
        if not frame.placed:
            return frame.X
        X = RigidTransform()  # of the placement frame in this one
        step = frame.placed
        # Poses from the placement frame P up to this frame A are composed; X is that of P, so that A has X inv(X_AP).
        for _ in range(len(self._frames) + 1):
            if step == name:
                return frame.X @ X.inverse()
            if step == WORLD or depth > 20:
                break
            X = self._local(step, frame.where, depth + 1) @ X
            step = self._frame(step, frame.where).base
        raise ModelError(f"placement frame '{frame.placed}' is not part of '{name}'", where=frame.where)
