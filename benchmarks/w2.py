"""Job W2: colours and depths of 640 x 480 pixels at 30 Hz among 36 obstacles, and pictures collected while driving."""

import tempfile
from math import radians
from pathlib import Path
from statistics import median
from typing import Any

from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import FixedOffsetFrame, PrismaticJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder

from benchmarks.timing import timed
from mirdrake.assembly.diagram import assemble
from mirdrake.assembly.diagram_spec import load_diagram
from mirdrake.plant.plant import add_world
from mirdrake.runs.simulation import Simulation
from mirdrake.sensors.cameras.camera import Camera
from mirdrake.sensors.cameras.merging import merge_still_things
from mirdrake.sensors.cameras.mounts import DepthCameraMount
from mirdrake.sensors.cameras.rendering import add_renderer, camera_params, use_plain_textures
from mirdrake.worlds import load_world

WIDTH, HEIGHT, RATE, DURATION = 640, 480, 30.0, 4.0
EYE, SPEED = 1.2, 0.5  # height of the camera [m]; how fast it moves ahead [m/s]
FIELD, NEAR, FAR = radians(60.0), 0.3, 60.0  # horizontal field of view [rad]; limits of depth [m]

COLLECTED_RATE = 25.0
"""Pictures per second of the drive that collects them [Hz]."""


class Scene:
    """A camera that moves slowly towards 36 obstacles on asphalt, without contact.

    Args:
        color: colours as well as depths.
    """

    def __init__(self, *, color: bool = True) -> None:
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlant(MultibodyPlantConfig(time_step=1.0 / 300.0), builder)
        eye = plant.AddRigidBody("eye", SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.1, 0.1))
        self._rail = plant.AddJoint(PrismaticJoint("rail", plant.world_frame(), eye.body_frame(), [1.0, 0.0, 0.0]))
        frame = plant.AddFrame(FixedOffsetFrame("mount", eye.body_frame(), RigidTransform([0.0, 0.0, EYE])))
        world = load_world("obstacles_36")
        add_world(plant, world)
        plant.Finalize()
        use_plain_textures(plant, scene_graph)
        merge_still_things(plant, scene_graph, merged_in=["w2"])
        add_renderer(scene_graph, "w2", camera_params(world))
        mount = DepthCameraMount(
            kind="depth_camera", frame="mount", rate=RATE, width=WIDTH, height=HEIGHT, horizontal_fov=FIELD,
            depth_near=NEAR, depth_far=FAR, color=color,
        )  # fmt: skip
        self.camera = builder.AddSystem(Camera(plant, frame, mount, renderer="w2"))
        builder.Connect(scene_graph.get_query_output_port(), self.camera.query_object)
        self._plant, self._diagram = plant, builder.Build()

    def run(self, duration: float) -> list[dict[str, Any]]:
        """Return the pictures of a run, taken as the recorder takes them."""
        context = self._diagram.CreateDefaultContext()
        self._rail.set_translation_rate(self._plant.GetMyMutableContextFromRoot(context), SPEED)
        simulator = Simulator(self._diagram, context)
        pictures: list[dict[str, Any]] = []

        def look(context: Context) -> None:
            if context.get_time() > len(pictures) / RATE - 1e-9:
                pictures.append(self.camera.look(context))

        simulator.set_monitor(look)
        simulator.Initialize()
        simulator.AdvanceTo(duration)
        return pictures


def collect(*, duration: float, repeat: int) -> dict[str, Any]:
    """Return the diagram ``collect_driving_data``, with the driving log and every picture on disk.

    Args:
        duration: simulated time [s].
        repeat: how often; medians are given.
    """
    simulation = Simulation(assemble(load_diagram("collect_driving_data", overrides=["record.report=false"])))
    times = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(repeat):
            run = Path(folder) / f"run{number}"
            times.append(timed(lambda run=run: simulation.run(duration=duration, folder=run)))  # type: ignore[misc]
        pictures = list((run / "ego.front_camera").glob("*.jpg"))
        size = sum(path.stat().st_size for path in pictures)
    count = round(duration * COLLECTED_RATE) + 1
    return {
        "rtf": duration / median(time.wall for time in times),
        "ms_per_picture": 1e3 * median(time.wall for time in times) / count,
        "cpu_ms_per_picture": 1e3 * median(time.cpu for time in times) / count,
        "pictures": len(pictures),
        "missing": count - len(pictures),
        "kb_per_picture": size / 1e3 / max(len(pictures), 1),
    }
