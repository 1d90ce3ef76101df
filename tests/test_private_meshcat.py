"""A Meshcat outlives what draws in it, whichever thread collects the garbage."""

import gc
import threading

from pydrake.geometry import MeshcatVisualizer, SceneGraph
from pydrake.systems.framework import DiagramBuilder

from mirdrake.viewer.private_meshcat import make_private_meshcat


def test_garbage_is_collected_on_another_thread_without_ending_the_process() -> None:
    meshcat, upstream = make_private_meshcat()
    builder = DiagramBuilder()
    scene = builder.AddSystem(SceneGraph())
    MeshcatVisualizer.AddToBuilder(builder, scene, meshcat)
    cycle = [meshcat, scene, builder.Build()]
    cycle.append(cycle)
    del meshcat, builder, scene, cycle
    collector = threading.Thread(target=gc.collect)
    collector.start()
    collector.join()
    assert upstream.get("/")[0] == 200
    upstream.close()
