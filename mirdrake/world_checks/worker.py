"""Program that computes overlaps of shapes by Drake, in a separate process because some queries end the process.

It imports only Drake, so that it starts quickly. A pickled job is read from standard input::

    {"shapes": [shape, ...], "pairs": [(shape a, X_WA, shape b, X_WB), ...]}    shapes by their numbers

For each pair it writes a line of JSON before the query, ``{"pair": 3}``, and one after it: ``{"hit": null}``, or
``{"hit": [depth [m], [x, y, z] in W [m]]}``.
"""

import json
import pickle
import sys
from typing import Any

from pydrake.geometry import FramePoseVector, GeometryFrame, GeometryInstance, ProximityProperties, SceneGraph, Shape
from pydrake.math import RigidTransform


class Couple:
    """Two shapes with moving frames, because Drake ignores pairs of anchored shapes."""

    def __init__(self, one: Shape, other: Shape) -> None:
        self._graph = SceneGraph()
        self._source = self._graph.RegisterSource("props")
        self._frames = []
        for name, shape in (("one", one), ("other", other)):
            frame = self._graph.RegisterFrame(self._source, GeometryFrame(name))
            instance = GeometryInstance(RigidTransform(), shape, name)
            instance.set_proximity_properties(ProximityProperties())
            self._graph.RegisterGeometry(self._source, frame, instance)
            self._frames.append(frame)
        self._context = self._graph.CreateDefaultContext()

    def find_hit(self, X_WA: RigidTransform, X_WB: RigidTransform) -> list[Any] | None:
        """Return depth [m] and position in W [m] of an overlap, or None; computed near the origin for accuracy."""
        poses = FramePoseVector()
        poses.set_value(self._frames[0], RigidTransform())
        poses.set_value(self._frames[1], X_WA.inverse() @ X_WB)
        self._graph.get_source_pose_port(self._source).FixValue(self._context, poses)
        query = self._graph.get_query_output_port().Eval(self._context)
        for hit in query.ComputePointPairPenetration():
            return [hit.depth, (X_WA @ (0.5 * (hit.p_WCa + hit.p_WCb))).tolist()]
        return None


def main() -> None:
    """Compute the overlaps of the job on standard input."""
    job = pickle.load(sys.stdin.buffer)
    shapes, couples = job["shapes"], {}
    for number, (a, X_WA, b, X_WB) in enumerate(job["pairs"]):
        _write({"pair": number})
        if (a, b) not in couples:
            couples[a, b] = Couple(shapes[a], shapes[b])
        _write({"hit": couples[a, b].find_hit(X_WA, X_WB)})


def _write(message: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
