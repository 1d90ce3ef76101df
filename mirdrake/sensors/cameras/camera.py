"""Cameras: colour, depth and label pictures at a rate; nothing is rendered between samples."""

import os
from math import tan
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    DepthRange,
    DepthRenderCamera,
    FramePoseVector,
    QueryObject,
    RenderCameraCore,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context, OutputPort
from pydrake.systems.sensors import CameraInfo, ImageDepth32F, ImageLabel16I, ImageRgba8U

from mirdrake.core.errors import ConfigError
from mirdrake.core.leaf_system import declare_cached_value
from mirdrake.core.yaml_io import where
from mirdrake.plant.seen_scene import SeenScene
from mirdrake.sensors.cameras.labels import SKY, label_names
from mirdrake.sensors.cameras.lens import view_of
from mirdrake.sensors.cameras.lens_map import LensMap
from mirdrake.sensors.cameras.mounts import DepthCameraMount, PictureMount, StereoCameraMount
from mirdrake.sensors.cameras.noise import color_noise, depth_noise
from mirdrake.sensors.cameras.rendering import vehicle_renderer
from mirdrake.sensors.noise import substream
from mirdrake.sensors.sampling import SampledValue, mount_pose, slots

if TYPE_CHECKING:
    from mirdrake.plant.plant import PlantParts, VehicleInPlant

X_SC = RigidTransform(RotationMatrix(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])))
"""Drake's camera frame C (z ahead, x to the right, y down) in the mounting frame S (x ahead, y left, z up)."""

BYTES_PER_PIXEL = 64
"""Approximate memory per pixel while rendering, including the buffers of the renderer."""

_EMPTY = 32766  # the number of RenderLabel.kEmpty


class Shot:
    """Pictures of one sample by name. They are read-only, so that a copy is the same object.

    Attributes:
        pictures: ``color`` (of a stereo camera ``left`` and ``right``) uint8 (height, width, 3), ``depth`` float32
            (height, width) [m], ``label`` uint16 (height, width).
    """

    def __init__(self, pictures: dict[str, NDArray[Any]]) -> None:
        self.pictures = pictures
        for picture in pictures.values():
            picture.setflags(write=False)

    def __deepcopy__(self, memory: Any) -> "Shot":
        return self


class Camera(SampledValue):
    """A camera that takes pictures at a rate and holds them until the next.

    As with all held samples, a picture taken at time t is at the output right after t + latency. Pixel (u, v) is column
    u from the left and row v from above; the middle of the first one is at (0, 0). A point (x, y, z) of the mounting
    frame is seen at u = (width - 1)/2 - f y/x, v = (height - 1)/2 - f z/x, with f = width / (2 tan(horizontal_fov/2));
    through a lens, y/x and z/x are distorted first. The eyes of a stereo camera are half the baseline to the left and
    to the right of the mounting frame: what is at x is seen f baseline / x pixels farther to the right by the left eye.

    The camera, and all that it sees, are where they are in the ground truth: at the time of the velocities, see
    :mod:`mirdrake.plant.seen_scene`.

    Input ports:
        plant_state: the plant's state, positions and velocities.
        actor_poses: poses of the actors, if the scene has any.
        query_object: the scene graph's, in place of both without `seen`.
    Output ports, each only if the mount asks for it:
        color_image: colours, a Drake ImageRgba8U; its ``data`` is (height, width, 4).
        left_color_image, right_color_image: of a stereo camera instead.
        depth_image_32f: depths along the x axis of the mounting frame [m], a Drake ImageDepth32F; 0 where it is too
            near and infinite where it is too far.
        label_image: labels of :attr:`labels`, a Drake ImageLabel16I.
        shot: all of them, a :class:`Shot`.
        stamp (1) [s]: when it was taken.

    Args:
        plant: the finalised plant.
        frame: mounting frame, x ahead and z up; fixed to a body.
        mount: resolution, field of view, clipping, rate and noise.
        renderer: name of a renderer of the scene graph.
        stream: stream from :func:`mirdrake.sensors.noise.noise_stream`.
        labels: names by label.
        seen: scene at the time of the velocities; None: the scene has the positions of the plant.

    Attributes:
        rate: pictures per second [Hz].
        labels: names by label.
    """

    record = "pictures"

    def __init__(
        self,
        plant: MultibodyPlant,
        frame: Frame,
        mount: PictureMount,
        *,
        renderer: str,
        stream: int = 0,
        labels: dict[int, str] | None = None,
        seen: SeenScene | None = None,
    ) -> None:
        self.labels, self._mount, self._seen = labels or {}, mount, seen
        self._lens = LensMap(mount) if mount.distortion is not None else None
        empty = Shot(_black(mount))
        super().__init__("shot", AbstractValue.Make(empty), mount, stream=stream)
        self._streams = {name: stream if name == "color" else substream(stream, name) for name in empty.pictures}
        if seen is None:
            self.query_object = self.DeclareAbstractInputPort("query_object", AbstractValue.Make(QueryObject()))
        else:
            self.plant_state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
            if seen.has_actors:
                self.actor_poses = self.DeclareAbstractInputPort("actor_poses", AbstractValue.Make(FramePoseVector()))
        body, X_BS = mount_pose(frame)
        self._body_frame = plant.GetBodyFrameIdOrThrow(body.index())
        # Each eye: mounting frame, half a baseline along y (left positive), then Drake's axes of a camera.
        half = 0.5 * mount.baseline if isinstance(mount, StereoCameraMount) else 0.0
        self._eyes = {
            name: X_BS @ RigidTransform([0.0, {"left": half, "right": -half}.get(name, 0.0), 0.0]) @ X_SC
            for name in empty.pictures
        }
        self._color_camera, self._depth_camera = self._render_cameras(renderer)
        # Also dependent on time: the number of the sample seeds its noise.
        inputs = [self.get_input_port(index).ticket() for index in range(self.num_input_ports())]
        needs = {self.time_ticket(), *inputs}
        self._now = declare_cached_value(self, "picture", AbstractValue.Make(empty).Clone, self._draw, needs)
        for name in empty.pictures:
            self._declare_image(name)

    def look(self, context: Context) -> dict[str, NDArray[Any]]:
        """Return the pictures of the present time by name, with noise; see :class:`Shot`.

        Args:
            context: Context of the whole diagram.
        """
        shot: Shot = self._now.evaluate(self.GetMyContextFromRoot(context))
        return dict(shot.pictures)

    def take(self, context: Context, index: int, sample: AbstractValue) -> None:  # noqa: ARG002
        """Write the present pictures; they are rendered once, even if :meth:`look` was called before."""
        sample.set_value(self._now.evaluate(context))

    def _render_cameras(self, renderer: str) -> tuple[ColorRenderCamera, DepthRenderCamera]:
        mount = self._mount
        if self._lens is None:
            width, height, focal = mount.width, mount.height, 0.5 * mount.width / tan(0.5 * mount.horizontal_fov)
        else:
            width, height, focal = self._lens.width, self._lens.height, self._lens.focal
        # The principal point is measured from the outer corner of the first pixel.
        info = CameraInfo(width, height, focal, focal, 0.5 * width, 0.5 * height)
        # One projection serves colour and labels, another the depth: a depth sensor has its own limits.
        limits = (mount.near, mount.far)
        if isinstance(mount, DepthCameraMount):
            limits = (mount.depth_near, mount.depth_far)
        # The clipping planes must contain the depth limits, or objects between them
        # are cut off before the depth is taken.
        near, far = min(mount.near, limits[0]), max(mount.far, limits[1])

        def core(near: float, far: float) -> RenderCameraCore:
            return RenderCameraCore(renderer, info, ClippingRange(near, far), RigidTransform())

        return (
            ColorRenderCamera(core(mount.near, mount.far), False),
            DepthRenderCamera(core(near, far), DepthRange(*limits)),
        )

    def _draw(self, context: Context, value: AbstractValue) -> None:
        query, index = self._query(context), round(context.get_time() * self.rate)
        pictures = {name: self._picture(name, query, X_BC, index) for name, X_BC in self._eyes.items()}
        value.set_value(Shot(pictures))

    def _query(self, context: Context) -> QueryObject:
        """Return the scene to render."""
        if self._seen is None:
            return self.query_object.Eval(context)
        actors = self.actor_poses.Eval(context) if self._seen.has_actors else None
        return self._seen.query(self.plant_state.Eval(context), actors)

    def _picture(self, name: str, query: QueryObject, X_BC: RigidTransform, index: int) -> NDArray[Any]:
        lens, stream = self._lens, self._streams[name]
        if name == "depth":
            depths = query.RenderDepthImage(self._depth_camera, self._body_frame, X_BC).data[:, :, 0]
            mount = self._mount
            assert isinstance(mount, DepthCameraMount)
            return depth_noise(depths if lens is None else lens.nearest(depths), mount, stream=stream, index=index)
        if name == "label":
            labels = query.RenderLabelImage(self._color_camera, self._body_frame, X_BC).data[:, :, 0].view(np.uint16)
            # `data` is a view of memory of Drake's image, and labels are changed below.
            labels = labels.copy() if lens is None else lens.nearest(labels)
            labels[labels == _EMPTY] = SKY
            return labels
        colors = query.RenderColorImage(self._color_camera, self._body_frame, X_BC).data
        if lens is not None:
            colors = lens.colors(colors)
        return color_noise(colors, self._mount.noise, stream=stream, index=index)

    def _declare_image(self, name: str) -> OutputPort:
        mount = self._mount
        kinds = {"depth": ("depth_image_32f", ImageDepth32F), "label": ("label_image", ImageLabel16I)}
        port, kind = kinds.get(name, ("color_image" if name == "color" else f"{name}_color_image", ImageRgba8U))

        held_index, stamp_index = int(self._held), self._held_stamp  # a callback that refers to self is never freed

        def show(context: Context, value: AbstractValue) -> None:
            shot: Shot = context.get_abstract_state(held_index).get_value()
            out, picture = value.get_mutable_value().mutable_data, shot.pictures[name]
            if picture.ndim == 2:
                out[:, :, 0] = picture
                return
            for channel in range(3):
                out[:, :, channel] = picture[:, :, channel]
            # Before the first sample, the black picture is transparent.
            out[:, :, 3] = 255 if context.get_discrete_state(stamp_index).get_value()[0] >= 0.0 else 0

        empty = AbstractValue.Make(kind(mount.width, mount.height))
        return self.DeclareAbstractOutputPort(port, empty.Clone, show, {self.all_state_ticket()})


def _black(mount: PictureMount) -> dict[str, NDArray[Any]]:
    """Return the pictures before the first sample: black, without any object."""
    size = (mount.height, mount.width)
    names = ["left", "right"] if isinstance(mount, StereoCameraMount) else ["color"]
    if isinstance(mount, DepthCameraMount) and not mount.color:
        names = []
    pictures: dict[str, NDArray[Any]] = {name: np.zeros((*size, 3), dtype=np.uint8) for name in names}
    if isinstance(mount, DepthCameraMount):
        pictures["depth"] = np.zeros(size, dtype=np.float32)
    if mount.label:
        pictures["label"] = np.zeros(size, dtype=np.uint16)
    return pictures


def make_camera(mount: PictureMount, *, parts: "PlantParts", part: "VehicleInPlant", stream: int) -> Camera:
    """Return the camera of a mount, of any kind; adds the vehicle's renderer if there is none yet.

    Raises:
        ConfigError: its pictures do not fit into memory.
        MissingDependencyError: there is nothing to render with.
    """
    check_memory(mount, part)
    renderer = vehicle_renderer(parts, part)
    frame = parts.plant.GetFrameByName(mount.frame, part.instance)
    labels = label_names(parts) if mount.label else {}
    return Camera(parts.plant, frame, mount, renderer=renderer, stream=stream, labels=labels, seen=parts.seen)


def check_memory(mount: PictureMount, part: "VehicleInPlant") -> None:
    """Check that the pictures fit into the memory of this machine.

    Raises:
        ConfigError: the reason.
    """
    if not hasattr(os, "sysconf") or "SC_PHYS_PAGES" not in os.sysconf_names:
        return
    pixels, eyes = mount.width * mount.height, 2 if isinstance(mount, StereoCameraMount) else 1
    # Each picture in flight needs its own slot of the queue.
    waiting = slots(mount.latency, mount.rate) if mount.latency else 1
    drawn = pixels
    if mount.distortion is not None:
        x, y = view_of(mount.distortion, width=mount.width, height=mount.height, horizontal_fov=mount.horizontal_fov)
        focal = 0.5 * mount.width / tan(0.5 * mount.horizontal_fov)
        # A distorted picture is resampled from a larger one, which dominates the memory.
        drawn = round(4.0 * x * y * focal * focal)
    needed = BYTES_PER_PIXEL * (drawn + (pixels if mount.distortion is not None else 0)) + 9 * pixels * eyes * waiting
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    # Half of the memory, as the plant, the meshes and other sensors need the rest.
    if needed > 0.5 * memory:
        spec = part.vehicle.sensors
        name = next((name for name, other in spec.mounts.items() if other is mount), "")
        raise ConfigError(
            f"{mount.width} x {mount.height} pixels, {waiting} pictures "
            f"at a time, take {needed / 1e9:.1f} GB; this machine has {memory / 1e9:.1f} GB; "
            "take fewer pixels or less latency",
            where=where(spec, "mounts", name, "width"),
        )
