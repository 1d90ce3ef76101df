"""OpenCRG files that the tests write, against closed forms."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirdrake.core.errors import ConfigError
from mirdrake.ground.crg_files import read_crg
from mirdrake.worlds.loading import make_world

STEP, WIDTH = 0.5, 0.25
V = np.arange(-2.0, 2.0 + 1e-9, WIDTH)
COUNT = 121  # 60 m
U = STEP * np.arange(COUNT)


def header(kind: str, *, channels: tuple[str, ...] = (), more: str = "", **numbers: float) -> str:
    """Return a header for the heights at V."""
    lines = ["$CT", "* a road of the tests", "hills and bends", "$", "$ROAD_CRG ! parameters"]
    values: dict[str, float] = {
        "reference_line_start_u": 0.0, "REFERENCE_LINE_END_U": U[-1], "REFERENCE_LINE_INCREMENT": STEP,
        "LONG_SECTION_V_RIGHT": V[0], "LONG_SECTION_V_LEFT": V[-1], "LONG_SECTION_V_INCREMENT": WIDTH,
    } | numbers  # fmt: skip
    lines += [f"{name} = {value:.6f} ! number" for name, value in values.items()]
    lines += ["$", "$KD_DEFINITION", f"#:{kind}", "U:reference line u,m,0,0.5"]
    lines += [f"D:reference line {name},1" for name in channels]
    lines += [f"D:long section {index + 1},m" for index in range(len(V))]
    return "\n".join([*lines, "$", *([more] if more else []), "$" * 60, ""])


def write(path: Path, kind: str, table: np.ndarray, **options: Any) -> Path:
    """Write a file."""
    head = header(kind, **options).encode()
    if kind in {"KRBI", "KDBI"}:
        body = table.astype(">f4" if kind == "KRBI" else ">f8").tobytes()
        size = 4 if kind == "KRBI" else 8
        missing = np.full(-len(body) % 80 // size, np.nan, ">f4" if kind == "KRBI" else ">f8").tobytes()
        path.write_bytes(head + body + missing)
        return path
    width = 10 if kind == "LRFI" else 20
    lines = []
    for row in table:
        fields = [f"{value:{width}.{width - 4}f}" if np.isfinite(value) else "*" * width for value in row]
        each = 80 // width
        lines += ["".join(fields[i : i + each]) for i in range(0, len(fields), each)]
    path.write_bytes(head + "\n".join(lines).encode() + b"\n")
    return path


def terrain(folder: Path, **entry: Any) -> Any:
    """Return the ground of a world with one file."""
    world = {"mirdrake": "world/1", "name": "x", "ground": {"relief": [{"crg": {"file": str(folder), **entry}}]}}
    return make_world(world).ground.terrain


@pytest.mark.parametrize("kind", ["LRFI", "LDFI", "KRBI", "KDBI"])
def test_a_straight_road_of_every_format(tmp_path, kind):
    z = 0.02 * np.sin(0.3 * U)[:, None] + 0.01 * V[None] ** 2
    ground = terrain(write(tmp_path / "a.crg", kind, z, REFERENCE_LINE_START_X=5.0, REFERENCE_LINE_START_Y=-1.0))
    # At the points of the table, and in the middle of four of them the mean, as it is bilinear.
    for i, j in ((0, 0), (7, 3), (120, 16), (60, 8)):
        assert ground.at(5.0 + U[i], -1.0 + V[j]).z == pytest.approx(z[i, j], abs=1e-6)
    middle = z[30:32, 4:6].mean()
    height, along, across = ground.slopes(5.0 + U[30] + 0.25, -1.0 + V[4] + 0.125)
    assert height == pytest.approx(middle, abs=1e-6)
    assert along == pytest.approx((z[31, 4:6] - z[30, 4:6]).mean() / STEP, abs=1e-5)
    assert across == pytest.approx((z[30:32, 5] - z[30:32, 4]).mean() / WIDTH, abs=1e-5)


@pytest.mark.parametrize("kind", ["LRFI", "KRBI"])
def test_a_banked_climb_in_a_bend(tmp_path, kind):
    radius, slope, bank = 40.0, 0.05, -0.08
    # The heading of a row is that of the piece before it; the first one does not count.
    phi = (U - 0.5 * STEP) / radius
    phi[0] = np.nan if kind == "LRFI" else 9.0
    channels = np.column_stack([phi, np.full(COUNT, slope), np.full(COUNT, bank)])
    bumps = np.zeros((COUNT, len(V)))
    bumps[60, 12] = 0.1  # 1 m to the left of the line at u = 30 m
    table = np.hstack([channels, bumps])
    path = write(tmp_path / "a.crg", kind, table, channels=("phi", "slope", "banking"), REFERENCE_LINE_START_Z=2.0)
    ground = terrain(path)
    for u, v, more in ((10.0, 1.5, 0.0), (30.0, 1.0, 0.1), (30.0, -1.0, 0.0), (55.25, -2.0, 0.0)):
        x, y = (radius - v) * np.sin(u / radius), radius - (radius - v) * np.cos(u / radius)
        assert ground.at(x, y).z == pytest.approx(2.0 + slope * u + bank * v + more, abs=2e-4)
    # The slope along the surface of a bend is larger inside: du is longer than the arc by 1 / (1 - v / R).
    u, v = 20.0, 1.5
    x, y = (radius - v) * np.sin(u / radius), radius - (radius - v) * np.cos(u / radius)
    _, zx, zy = ground.slopes(x, y)
    tangent = np.cos(u / radius), np.sin(u / radius)
    assert zx * tangent[0] + zy * tangent[1] == pytest.approx(slope / (1.0 - v / radius), rel=1e-3)
    assert -zx * tangent[1] + zy * tangent[0] == pytest.approx(bank, rel=1e-3)


def test_a_road_is_placed_and_blends_into_the_ground(tmp_path):
    path = write(tmp_path / "a.crg", "KRBI", np.full((COUNT, len(V)), 0.3))
    ground = terrain(path, at=[100.0, 50.0], yaw="90 deg", height="1 m", embankment="4 m")
    assert ground.at(100.0, 80.0).z == pytest.approx(1.3)
    assert ground.at(101.9, 80.0).z == pytest.approx(1.3)
    # Half of the embankment beside the right edge.
    assert ground.at(104.0, 80.0).z == pytest.approx(0.65)
    assert ground.at(107.0, 80.0).z == pytest.approx(0.0)


def test_missing_heights_at_the_borders_get_those_beside_them(tmp_path):
    z = np.tile(V, (COUNT, 1))
    z[:, :2] = np.nan
    assert read_crg(write(tmp_path / "a.crg", "LRFI", z)).heights[5, :4] == pytest.approx([-1.5, -1.5, -1.5, -1.25])


def test_few_stations_describe_a_long_line(tmp_path):
    radius = 200.0
    phi = (U - 0.5 * STEP) / radius
    table = np.hstack([phi[:, None], np.zeros((COUNT, len(V)))])
    ground = terrain(write(tmp_path / "a.crg", "KDBI", table, channels=("phi",)))
    (layer,) = ground.data.layers
    assert layer["rows"] == 31  # every fourth of 121 points, and the last one


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"more": "$ROAD_CRG_MODS\nSCALE_Z_GRID = 2\n$"}, r"\$ROAD_CRG_MODS is not supported"),
        ({"channels": ("camber",)}, "unknown channel 'reference line camber'"),
        ({"REFERENCE_LINE_END_U": 1e4}, "121 rows; the header needs"),
        ({"REFERENCE_LINE_INCREMENT": 0.0}, "not positive"),
        ({"LONG_SECTION_V_RIGHT": 1.0, "LONG_SECTION_V_LEFT": 5.0}, "beside the road"),
    ],
)
def test_messages(tmp_path, change, message):
    path = write(tmp_path / "a.crg", "KRBI", np.zeros((COUNT, len(V) + len(change.get("channels", ())))), **change)
    with pytest.raises(ConfigError, match=message):
        read_crg(path)


def test_a_file_that_is_something_else(tmp_path):
    (tmp_path / "a.crg").write_bytes(b"\x00\xff" * 500)
    with pytest.raises(ConfigError, match="cannot be read as OpenCRG: its header has no end"):
        read_crg(tmp_path / "a.crg")
    with pytest.raises(ConfigError, match="no such file"):
        read_crg(tmp_path / "b.crg")
