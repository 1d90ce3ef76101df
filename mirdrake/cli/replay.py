"""``mirdrake replay``: replay a run with the pictures of its cameras."""

import argparse
import contextlib
from pathlib import Path

from mirdrake.cli.common import print_changes, whole_number
from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import display_path

MORE = """\
The page has play controls and the views follow, cockpit and map (keys 1, 2, 3); camera pictures are shown at the time
of the recording. --out writes a page that opens offline, with at most 2400 pictures of reduced size. A run that was
killed can be replayed as well.

examples:
  mirdrake replay runs/drive
  mirdrake replay runs/drive --out replay.html"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("run", metavar="RUN", help="a run folder")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write an HTML page that opens offline, and stop")
    parser.add_argument(
        "--port", type=whole_number(0, 65_535), default=0, help="port on localhost (default: any free port)"
    )


def run(options: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C, or write it."""
    from mirdrake.runs.logs import load_run
    from mirdrake.viewer.replay import Replay, write_replay

    done = load_run(options.run)
    # A page in a file contains everything; without one the run is served from its folder.
    if options.out is not None:
        if options.out.is_dir():
            raise ConfigError(f"--out {options.out}: is a folder; a file is expected")
        write_replay(done, options.out)
        print_changes(done.scene())
        print(display_path(options.out))
        return 0
    replay = Replay(done, port=options.port)
    print_changes(done.scene())
    print(f"Replay: {replay.url}  (Ctrl-C ends)", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        replay.serve()
    return 0
