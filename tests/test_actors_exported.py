"""Actors in an MCAP file: their shapes once, and the poses of their frames at each sample."""

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirdrake.export.mcap import write_mcap
from mirdrake.runs.logs import load_run
from tests.actor_rigs import simulation, world_file

ACTORS = [
    {"actor": "sedan", "name": "lead", "on_track": {"track": "main", "s": 40}, "speed": 6, "color": "firebrick"},
    {"actor": "wall", "name": "gate", "path": [[30, -8], [30, 8]], "speed": 2},
]


def test_the_3d_panel_shows_actors_as_they_look_where_they_are(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    reading, decoding = pytest.importorskip("mcap.reader"), pytest.importorskip("mcap_protobuf.decoder")
    drive = simulation(world_file(tmp_path, actors=ACTORS))
    drive.run(duration=1.0, folder=tmp_path / "run")
    run = load_run(tmp_path / "run")
    write_mcap(run, tmp_path / "run.mcap")
    scenes: list[Any] = []
    poses: dict[str, list[tuple[float, Any]]] = {}
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = reading.make_reader(file, decoder_factories=[decoding.DecoderFactory()])
        for _, channel, message, content in reader.iter_decoded_messages(topics=["/actors", "/tf"]):
            if channel.topic == "/actors":
                scenes.append(content)
            elif channel.topic == "/tf":
                for entry in content.transforms:
                    poses.setdefault(entry.child_frame_id, []).append((message.log_time, entry))

    # Each actor is an entity in its own frame.
    (scene,) = scenes
    entities = {entity.id: entity for entity in scene.entities}
    assert set(entities) == {"actors.gate", "actors.lead"}
    assert all(entity.frame_locked and entity.frame_id == name for name, entity in entities.items())
    # The mesh of the car is ahead of its rear axle, which its frame is below.
    (model,) = entities["actors.lead"].models
    lead, gate = (
        next(actor for actor in drive.assembly.parts.world.actors if actor.name == name) for name in ("lead", "gate")
    )
    assert model.pose.position.x == pytest.approx(lead.rear_axle)
    bounds = trimesh.load(io.BytesIO(model.data), file_type="glb").bounds
    assert np.ptp(bounds, axis=0).max() * model.scale.x == pytest.approx(lead.prop.size[0], rel=0.05)
    shapes = entities["actors.gate"]
    assert len(shapes.cubes) + len(shapes.models) + len(shapes.triangles) >= 1

    # Their frames move as recorded.
    for actor in (lead, gate):
        rows = poses[f"actors.{actor.name}"]
        assert len(rows) == len(run.actors)
        for (_, entry), time in zip(rows, run.actors.index, strict=True):
            x, y, yaw = (float(run.actors[f"{actor.name}.{key}"].loc[time]) for key in ("x", "y", "yaw"))
            assert (entry.translation.x, entry.translation.y) == pytest.approx((x, y))
            assert 2.0 * math.atan2(entry.rotation.z, entry.rotation.w) == pytest.approx(yaw)
    assert poses["actors.gate"][-1][1].translation.y > poses["actors.gate"][0][1].translation.y + 1.5
