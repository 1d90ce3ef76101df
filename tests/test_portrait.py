"""The rendered still of a vehicle."""

import dataclasses
import shutil
import sys

import numpy as np
import pytest
from PIL import Image

from mirdrake.core.errors import MissingDependencyError
from mirdrake.sensors.cameras import rendering as camera
from mirdrake.vehicles import load_vehicle
from mirdrake.viewer.portrait import draw_portrait, main, try_portrait

needs_egl = pytest.mark.skipif(camera._egl_fault() is not None, reason="needs EGL")


@pytest.fixture(scope="module")
def bolt():
    """A small portrait of a Bolt: rows of red, green, blue."""
    return np.asarray(draw_portrait(load_vehicle("bolt"), width=320, height=180)).astype(int)


@needs_egl
class TestPicture:
    """Content of the image."""

    def test_it_has_the_size_asked_for(self, bolt):
        assert bolt.shape == (180, 320, 3)

    def test_the_car_fills_the_picture_and_leaves_room_on_every_side(self, bolt):
        paint = (bolt[..., 2] > bolt[..., 0] + 80) & (bolt[..., 2] > bolt[..., 1] + 40)
        rows, columns = np.nonzero(paint)
        assert paint.mean() > 0.15
        # A margin of 1.22 around the widest or highest: 1 / 1.22 of the picture between 9 % and 91 %.
        assert 0.05 < columns.min() / 320 < columns.max() / 320 < 0.95
        assert 0.02 < rows.min() / 180 < rows.max() / 180 < 0.98

    def test_the_sky_is_above_and_pales_downwards_and_the_asphalt_is_grey(self, bolt):
        sky = bolt[:8, :40].mean(axis=(0, 1))
        assert sky[2] > sky[0] + 10
        assert bolt[8, :40].mean() > bolt[0, :40].mean()
        road = bolt[-12:, :40].mean(axis=(0, 1))
        assert np.ptp(road) < 12
        assert 30 < road.mean() < 160

    def test_no_edge_against_the_sky_has_a_tint_that_neither_side_has(self, bolt):
        """At the horizon the renderer mixes asphalt, which is grey, with what it draws behind it."""
        column = bolt[:, :6].mean(axis=1)
        assert (np.minimum(column[:, 0], column[:, 2]) - column[:, 1]).max() < 6
        tinted = (bolt[..., 0] > bolt[..., 1] + 40) & (bolt[..., 2] > bolt[..., 1] + 40)
        assert not tinted.any()

    def test_the_same_vehicle_gives_the_same_picture(self, bolt):
        again = np.asarray(draw_portrait(load_vehicle("bolt"), width=320, height=180)).astype(int)
        assert np.abs(again - bolt).max() <= 1

    def test_a_vehicle_without_meshes_still_has_its_road(self):
        vehicle = load_vehicle("bolt")
        bare = "\n".join(line for line in vehicle.urdf.split("\n"))
        while "<visual" in bare:
            begin = bare.index("<visual")
            bare = bare[:begin] + bare[bare.index("</visual>") + len("</visual>") :]
        picture = np.asarray(draw_portrait(dataclasses.replace(vehicle, urdf=bare), width=64, height=36))
        assert picture.std() > 5.0


def test_without_egl_there_is_a_reason_and_for_an_ornament_nothing(monkeypatch):
    monkeypatch.setattr(camera, "_egl_fault", lambda: "libEGL.so.1 is not installed")
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(
        MissingDependencyError, match=r"a portrait needs EGL.*libEGL.so.1 is not installed.*apt install"
    ):
        draw_portrait(load_vehicle("bolt"), width=64, height=36)
    assert try_portrait(load_vehicle("bolt"), width=64, height=36) is None


def copy_of_bolt(tmp_path):
    return shutil.copytree(load_vehicle("bolt").folder, tmp_path / "bolt")


@needs_egl
def test_a_readme_shows_the_portrait_below_its_title(tmp_path, monkeypatch):
    folder = copy_of_bolt(tmp_path)
    before = (folder / "README.md").read_text()
    monkeypatch.setattr(sys, "argv", ["portrait", str(folder)])
    assert main() == 0
    title, rest = before.split("\n", 1)
    assert (folder / "README.md").read_text() == f"{title}\n\n![{title[2:]}](portrait.png)\n{rest}"
    with Image.open(folder / "portrait.png") as picture:
        assert picture.size == (960, 540)


def test_without_egl_the_readme_stays_and_the_reason_is_reported(tmp_path, monkeypatch, capsys):
    folder = copy_of_bolt(tmp_path)
    before = (folder / "README.md").read_text()
    monkeypatch.setattr(camera, "_egl_fault", lambda: "libEGL.so.1 is not installed")
    monkeypatch.setattr(sys, "argv", ["portrait", str(folder)])
    assert main() == 2
    assert "libEGL.so.1 is not installed" in capsys.readouterr().err
    assert (folder / "README.md").read_text() == before
    assert not (folder / "portrait.png").exists()
