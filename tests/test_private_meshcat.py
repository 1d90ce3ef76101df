"""A Meshcat outlives the objects that draw in it, whichever thread collects the garbage."""

import gc
import os
import threading
from pathlib import Path

import pytest
from pydrake.geometry import MeshcatVisualizer, SceneGraph
from pydrake.systems.framework import DiagramBuilder

from mirdrake.viewer import private_meshcat
from mirdrake.viewer.inline import show
from mirdrake.viewer.private_meshcat import make_private_meshcat
from mirdrake.worlds import load_world


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


def test_where_the_socket_cannot_be_replaced_meshcat_listens_on_a_port_that_pages_may_not_use(monkeypatch) -> None:
    """Each Meshcat keeps five file descriptors until the process ends, so that the test makes two of them only."""

    def fail(_: int) -> int:
        raise OSError("no /proc")

    monkeypatch.setattr(private_meshcat, "_replace_listener", fail)
    meshcat, upstream = make_private_meshcat()
    assert meshcat.port() in private_meshcat.BLOCKED_PORTS
    meshcat.SetProperty("/Background", "visible", True)
    status, kind, page = upstream.get("/")
    assert (status, kind) == (200, "text/html; charset=utf-8")
    assert b"meshcat" in page.lower()
    with upstream.connect() as connection:
        assert connection.getpeername() == ("127.0.0.1", meshcat.port())
    upstream.close()
    with pytest.raises(OSError, match=r".+"):
        upstream.connect()


def test_without_proc_no_other_meshcat_is_made_first(monkeypatch) -> None:
    created: list[str] = []

    def make(*, host: str, port: int, url: str) -> object:
        created.append(f"{host}:{port}")
        return object()

    monkeypatch.setattr(private_meshcat, "_make", make)
    monkeypatch.setattr(private_meshcat, "_DESCRIPTORS", Path("/nonexistent"))
    make_private_meshcat()
    assert created == ["127.0.0.1:6000"]


def test_views_for_notebooks_free_their_file_descriptors() -> None:
    show(load_world("empty"))  # opens files that stay open
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(3):
        assert "<html" in show(load_world("empty")).page
    assert len(os.listdir("/proc/self/fd")) <= before
