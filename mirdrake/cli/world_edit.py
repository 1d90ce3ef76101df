"""``mirdrake world edit``: edit a world in the browser; the file stays the truth."""

import argparse

from mirdrake.cli.common import whole_number

MORE = """\
Prints an address and waits. Drag props and groups from the palette, move and turn them on the map, or type their
values; overlaps are red while you drag. Each gesture changes as little of the file as possible: comments and layout
stay. Ctrl-S saves, Ctrl-Z undoes. Ctrl-C ends; a text that is not saved is kept in a hidden file for the next time.
A file that does not exist begins as an empty world.

examples:
  mirdrake world edit yard.yaml
  mirdrake world edit worlds/parking_lot.yaml --port 8785"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("file", metavar="FILE", help="path of a world file, new or existing, or name of a world")
    parser.add_argument(
        "--port",
        type=whole_number(0, 65_535),
        metavar="N",
        help="port of localhost (default: the first free from 8785)",
    )


def run(options: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    from mirdrake.editor.editor import Editor, world_path

    editor = Editor(world_path(options.file), port=options.port)
    # A file that cannot be written can still be looked at.
    if editor.document.read_only:
        print(f"warning: {editor.document.name}: {editor.document.read_only}", flush=True)
    print(f"World editor: {editor.url}  (Ctrl-C ends)", flush=True)
    try:
        editor.serve()
    except KeyboardInterrupt:
        # The unsaved text is kept beside the file, so that Ctrl-C loses nothing.
        if editor.document.is_kept:
            print(f"warning: {editor.document.name}: not saved; the next `world edit` restores the text", flush=True)
    finally:
        editor.server.stop_listening()
        editor.release()
    return 0
