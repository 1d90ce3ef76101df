"""The editor behind the page: one document, its scene, and the answers to the page's messages."""

import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack, nullcontext, suppress
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from mirdrake.core.errors import ConfigError, MirdrakeError
from mirdrake.core.json_io import Json
from mirdrake.core.paths import find
from mirdrake.editor.case_runner import CaseRunner
from mirdrake.editor.checker import Checker
from mirdrake.editor.document import Document, revision_of
from mirdrake.editor.elements import BODY, TURN, LockedError
from mirdrake.editor.gestures import Gesture, Move, TextGesture, changes_of, read_gesture
from mirdrake.editor.marks import load_machine_code, mark_moved, mark_overlaps
from mirdrake.editor.palette import palette, picture
from mirdrake.editor.picture import error_json, make_picture, mark_json, path_of
from mirdrake.editor.scene import Scene, read_scene
from mirdrake.editor.view import View
from mirdrake.viewer.server import Answer, PageServer
from mirdrake.worlds.loading import parse_world

PORT = 8785
"""First port to try."""

_TRIED = 20  # ports from there on
_LARGEST = 4_000_000  # bytes of a message, as a typed text may be long
_PREPARED_AFTER = 1.5  # s
_GHOST_SEEDS = 20  # draws that are shown as ghosts
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}

Message = Mapping[str, Any]
Reply = Json


class Editor:
    """Serves the page of one world file until it is closed.

    Args:
        path: the world file; it is made by the first save if there is none.
        port: port of localhost; None takes the first free one from :data:`PORT` on.

    Attributes:
        document: the text.
        server: server of the page.
        scene: scene of the last text without faults.

    Raises:
        ConfigError: the file has faults.
        WorldError: the world cannot be laid out.
        RunError: no port is free.
    """

    def __init__(self, path: Path, *, port: int | None = None) -> None:
        # The document takes the lock of the file; everything that fails after it has to release that,
        # and to end the threads that were started.
        self.document = Document(path)
        self._lock = threading.Lock()
        # Everything that was opened is closed if a later part fails, for example without a free port.
        with ExitStack() as undo:
            undo.callback(self.document.close)
            self.scene, self._faults = self._first_scene(path)
            self._marks = mark_overlaps(self.scene)
            self._tests = CaseRunner(path)
            self._checker = Checker(path)
            undo.callback(self._checker.close)
            self._view = View()
            undo.callback(self._view.close)
            posts: dict[str, Callable[[Message], Reply]] = {
                "state": self._state, "gesture": self._gesture, "preview": self._preview, "undo": self._undo,
                "redo": self._redo, "save": self._save, "reload": self._reload, "ghosts": self._ghosts,
                "test": self._test, "palette": self._palette, "draw": self._draw,
            }  # fmt: skip
            self.server = PageServer(
                "the world editor",
                # An explicit port must be that one; otherwise the last resort is any free one.
                ports=[port] if port is not None else [*range(PORT, PORT + _TRIED), 0],
                files=self._file,
                posts={name: self._guarded(post, alone=name != "ghosts") for name, post in posts.items()},
                largest=_LARGEST,
            )
            undo.pop_all()
        # The first check runs beside the page, which opens at once.
        self._checker.check(self.document.text)
        # Not while the page is being opened, and before the first prop is dragged.
        self._prepared = threading.Timer(_PREPARED_AFTER, load_machine_code)
        self._prepared.daemon = True
        self._prepared.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        return self.server.url

    def serve(self) -> None:
        """Serve until the process ends or :meth:`close` is called."""
        self.server.serve()

    def start(self) -> None:
        """Serve in a new thread."""
        self.server.start()

    def close(self) -> None:
        """Stop serving and release the file; a text that is not saved is kept for the next editor."""
        self.server.close()
        self.release()

    def release(self) -> None:
        """Stop the checks and release the file, after serving has ended."""
        self._prepared.cancel()
        self._checker.close()
        self._tests.close()
        self._view.close()
        self.document.close()

    def _repr_html_(self) -> str:
        """Return the page for a notebook."""
        return f'<iframe src="{self.url}" width="100%" height="760" style="border: 1px solid #ccd5df"></iframe>'

    # Files and messages of the page.

    def _file(self, path: str) -> Answer | None:
        kind, _, name = path.partition("/")
        if kind == "replay":
            file = self._tests.recording(unquote(name))
            return None if file is None else (file.read_bytes(), "text/html; charset=utf-8")
        if kind == "palette":
            category, _, name = unquote(name).removesuffix(".png").partition("/")
            scene = self.scene
            known = {"what": category, "name": name} in palette(scene.world)
            content = picture(category, name, scene.data, self.document.path) if known else None
            return None if content is None else (content, "image/png")
        name = path or "editor.html"
        page = files("mirdrake.editor") / "page" / name
        content_type = _TYPES.get(Path(name).suffix)
        # A name with a slash could lead out of the folder of the page.
        if "/" in name or content_type is None or not page.is_file():
            return None
        return page.read_bytes(), f"{content_type}; charset=utf-8"

    def _guarded(self, post: Callable[[Message], Reply], *, alone: bool) -> Callable[[Message], Reply]:
        def answer(message: Message) -> Reply:
            # One message at a time: threads of the server share the document and the scene. Ghosts take seconds in a
            # large world, and read only the scene that was there when they began.
            with self._lock if alone else nullcontext():
                try:
                    return post(message)
                except (LockedError, MirdrakeError) as error:
                    return {"error": str(error)}
                # A message with other types is a fault of the page and must not end the server.
                except (TypeError, ValueError, KeyError, OverflowError, RecursionError):
                    return {"error": "the message of the page cannot be read"}

        return answer

    def _first_scene(self, path: Path) -> tuple[Scene, list[Json]]:
        """Return the scene of the text; if it is a restored one with faults, that of the file, and the faults."""
        try:
            return read_scene(self.document.text, path), []
        except MirdrakeError as error:
            if not self.document.restored:
                raise
            faults = error_json(error, self.document.path)
        return read_scene(self.document.file_text, path), faults

    def _status(self) -> Reply:
        document = self.document
        return {
            "revision": revision_of(document.text), "file": document.name, "saved": document.is_saved,
            "undo": document.can_undo, "redo": document.can_redo, "read_only": document.read_only,
            "outside": document.changed_outside(), "restored": document.restored, "faults": self._faults,
            "check": self._check(), "tests": self._tests.state(),
        }  # fmt: skip

    def _check(self) -> Reply | None:
        result = self._checker.result
        if result is None:
            return None
        revision, faults = result
        return {"fresh": revision == revision_of(self.document.text), "faults": faults}

    def _everything(self) -> Reply:
        return {
            **self._status(), "text": self.document.text, "scene": make_picture(self.scene),
            "marks": mark_json(self._marks), "test_names": [test.name for test in self._spec_tests()],
            "seed": self.scene.world.spec.seed, "groups": list(self.scene.world.spec.groups),
        }  # fmt: skip

    def _spec_tests(self) -> list[Any]:
        return list(self.scene.world.spec.tests)

    def _state(self, message: Message) -> Reply:
        """Return the status alone if the page has the present revision."""
        # The page asks often; the whole scene is sent only if the text has changed.
        if message.get("revision") == revision_of(self.document.text) and not message.get("all"):
            return self._status()
        return self._everything()

    def _gesture(self, message: Message) -> Reply:
        gesture = read_gesture(message)
        return self._changed(gesture.text(self.scene, self.document.name), gesture)

    def _changed(self, text: str, gesture: Gesture | None = None) -> Reply:
        """Take a text; one with faults is taken only if it was typed, and the map keeps the last valid world."""
        try:
            scene = read_scene(text, self.document.path)
        except MirdrakeError as error:
            if not isinstance(gesture, TextGesture):
                # Typed text may be invalid for a while; a gesture must not make the text invalid.
                raise
            self.document.change(text)
            self._faults = error_json(error, self.document.path)
            return {**self._status(), "text": text}
        self.document.change(text)
        return self._show(scene)

    def _show(self, scene: Scene) -> Reply:
        self.scene, self._faults, self._marks = scene, [], mark_overlaps(scene)
        self._checker.check(scene.text)
        return self._everything()

    def _preview(self, message: Message) -> Reply:
        """Return the overlaps while handles are dragged; the text stays."""
        moves = [Move.model_validate(move) for move in message["moves"]]
        changes_of(self.scene, moves)  # raises if one cannot be dragged
        moved = []
        for move in moves:
            element = self.scene.element(move.element)
            body = element.handle(BODY)
            if move.handle == BODY:
                shift = (move.x - body.x, move.y - body.y, 0.0)
            elif move.handle == TURN:
                shift = (0.0, 0.0, float(message.get("turn", 0.0)))
            else:
                continue
            moved += [(placed, *shift) for placed in self.scene.props_of(move.element)]
        # Overlaps of props that are not moved stay.
        names = {placed.name for placed, *_ in moved}
        marks = [mark for mark in self._marks if names.isdisjoint(mark.names)]
        marks += mark_moved(self.scene, moved) if moved else []
        return {"sequence": message.get("sequence"), "marks": mark_json(marks)}

    def _undo(self, _: Message) -> Reply:
        self.document.undo()
        return self._read_again()

    def _redo(self, _: Message) -> Reply:
        self.document.redo()
        return self._read_again()

    def _read_again(self) -> Reply:
        """Show the present text; the map is unchanged if the text has faults."""
        try:
            return self._show(read_scene(self.document.text, self.document.path))
        except MirdrakeError as error:
            self._faults = error_json(error, self.document.path)
            return {**self._status(), "text": self.document.text}

    def _save(self, message: Message) -> Reply:
        self.document.save(overwrite=bool(message.get("overwrite", False)))
        return self._status()

    def _reload(self, _: Message) -> Reply:
        self.document.reload()
        return self._read_again()

    def _ghosts(self, _: Message) -> Reply:
        """Return the outlines of random props under other seeds; None for a seed whose world cannot be laid out."""
        scene, ghosts = self.scene, list[Json]()
        for step in range(1, _GHOST_SEEDS + 1):
            seed, outlines = scene.world.spec.seed + step, None
            with suppress(MirdrakeError):
                world = parse_world(scene.text, self.document.path, seed=seed)
                outlines = [path_of(placed.footprint) for placed in world.props if placed.random]
            ghosts.append({"seed": seed, "outlines": outlines})
        return {"ghosts": ghosts}

    def _test(self, message: Message) -> Reply:
        name = str(message.get("name", ""))
        if message.get("stop"):
            self._tests.stop()
        # A test runs the file, not the text in the editor.
        elif not self.document.is_saved:
            raise ConfigError("the world is not saved; save it, then run its tests")
        else:
            # `name#3` is one case of a test.
            known = name.partition("#")[0] in {test.name for test in self._spec_tests()}
            self._tests.run(name if known else "")
        return self._status()

    def _draw(self, _: Message) -> Reply:
        """Draw the scene in Meshcat, for the frame of the page."""
        self._view.draw(self.scene.world)
        self.server.upstream = self._view.upstream
        return {"drawn": revision_of(self.scene.text)}

    def _palette(self, _: Message) -> Reply:
        return {"palette": palette(self.scene.world)}


def edit_world(name: str, *, port: int | None = None) -> Editor:
    """Open a world file in an editor, for a notebook: the returned object shows the page in the output of a cell.

    Args:
        name: path of a world file, which need not exist yet, or name of a world below worlds/.
        port: port of localhost; None takes a free one.

    Raises:
        ConfigError: the file has faults.
        WorldError: the world cannot be laid out.
        RunError: no port is free.
    """
    editor = Editor(world_path(name), port=port)
    editor.start()
    return editor


def world_path(name: str) -> Path:
    """Return the path of a world file, new or existing, of a path or name.

    Raises:
        ConfigError: the world is a bundled one, which cannot be changed, or does not exist.
    """
    path = Path(name)
    is_path = path.suffix in {".yaml", ".yml"}
    if is_path and not path.exists():
        if not path.parent.is_dir():
            raise ConfigError(f"the folder '{path.parent}' does not exist; create it first", where=name)
        return path.resolve()
    return path.resolve() if is_path else find("worlds", name)
