"""``mirdrake export``: a run in formats of other tools."""

import argparse
from pathlib import Path

from mirdrake.cli.common import print_changes
from mirdrake.core.errors import ConfigError
from mirdrake.core.wording import plural
from mirdrake.core.yaml_io import display_path

MORE = """\
mcap    run.mcap: signals, poses, pictures, scans and events, for Foxglove and other readers of MCAP
csv     signals.csv: all signals, with units in the header:  time [s],ego.x [m],ego.lap
        signals.ego.imu.csv: each sample of the sensor ego.imu, and one file for each other sensor whose
        samples are numbers; scans and pictures stay in the run folder
video   <camera>.mp4: the pictures of each camera, each frame at the time it was taken
Files are written into the run folder unless --out is given. A run that was killed can be exported as well.

examples:
  mirdrake export runs/drive --to mcap
  mirdrake export runs/drive --to video --out /tmp/films"""

FORMATS = ("mcap", "csv", "video")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("run", metavar="RUN", help="a run folder")
    parser.add_argument("--to", required=True, choices=FORMATS, help="the format")
    parser.add_argument("--out", type=Path, metavar="PATH", help="the file; for video the folder")


def run(options: argparse.Namespace) -> int:
    """Write the run in the format."""
    from mirdrake.runs.logs import load_run

    done = load_run(options.run)
    # Only MCAP contains the scene, for which differences to today's files matter.
    if options.to == "mcap":
        print_changes(done.scene())
    folder = Path(options.run)
    # Videos are several files, one per camera, so that --out is a folder; the other formats are one file.
    if options.to == "video":
        from mirdrake.export.video import write_videos

        target = options.out or folder
        if not target.is_dir():
            raise ConfigError(f"--out {target}: is not a folder; make it first")
        for path, frames in write_videos(done, target).items():
            print(f"{display_path(path)}  {frames} frames")
        return 0
    path = options.out or folder / {"mcap": "run.mcap", "csv": "signals.csv"}[options.to]
    if path.is_dir():
        raise ConfigError(f"--out {path}: is a folder; a file is expected")
    if options.to == "csv":
        from mirdrake.export.tables import write_csv

        for table, rows in write_csv(done, path).items():
            print(f"{display_path(table)}  {plural(rows, 'row')}")
        return 0
    from mirdrake.export.mcap import write_mcap

    counts = write_mcap(done, path)
    print(display_path(path))
    for topic, count in sorted(counts.items()):
        print(f"  {topic:32} {plural(count, 'message')}")
    return 0
