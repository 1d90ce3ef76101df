"""A world editor in the browser: the world file stays the truth, the page shows it and sends gestures.

::

    world.yaml ── Document ──► text, undo, save                       document.py
    text ── read_scene ──► World, elements with handles               scene.py, elements.py, values.py,
                                                                      layouts.py, actors.py, roads.py
    gesture + text ── apply_gesture ──► text                          gestures.py
    World ── make_picture ──► JSON for the page                       picture.py
    moved props ── mark_overlaps ──► overlaps while dragging          marks.py
    text ── Checker ──► faults, in a separate process                 checker.py
    file ── CaseRunner ──► verdicts and recordings of its tests       case_runner.py
    props ── picture ──► pictures of the palette                      palette.py
    all of it ── Editor ──► answers to the page                       editor.py, page/

The page holds no state of the world: each gesture becomes a change of the text, from which the world is made again.
"""

from mirdrake.editor.editor import Editor, edit_world

__all__ = ["Editor", "edit_world"]
