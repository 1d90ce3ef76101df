"""``mirdrake identify new``: write a data file for a log, with guesses of its channels."""

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from mirdrake.cli.common import add_quiet
from mirdrake.core.errors import ConfigError
from mirdrake.core.files import write_file
from mirdrake.core.wording import plural
from mirdrake.core.yaml_io import display_path

if TYPE_CHECKING:
    from mirdrake.identification.proposals import DataProposal

MORE = """\
LOG is a file of any known format, a bag or a run folder. Channels are guessed by the names of columns (English, German,
French) or the types of messages, units and signs by the file and by the relations between channels. The data file has
each guess with its reason as a comment: check them, then run the two commands that are printed. The file is printed as
well, or with --out a summary of it.

examples:
  mirdrake identify new lap.csv
  mirdrake identify new drive.mcap --out drives.yaml"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("log", type=Path, metavar="LOG", help="recorded log")
    parser.add_argument("--out", type=Path, metavar="FILE.yaml", help="data file (default: LOG with the suffix .yaml)")
    parser.add_argument("--force", action="store_true", help="replace a data file that exists")
    add_quiet(parser)


def run(options: argparse.Namespace) -> int:
    """Write the data file and print what is missing in it."""
    from mirdrake.identification.proposal_text import proposal_text
    from mirdrake.identification.proposals import missing_channels, propose_data

    log: Path = options.log
    out: Path = options.out or log.with_suffix(".yaml")
    if out.exists() and not options.force:
        raise ConfigError("exists already; give --out FILE.yaml, or --force to replace it", where=display_path(out))
    proposal = propose_data(log)
    if not proposal.channels:
        names = ", ".join(other.column for other in proposal.others[:20])
        known = "no column has a known name; map them with --map of identify check"
        if any(note.startswith("has no header") for note in proposal.notes):
            known = "has no header; map its columns by their numbers from 1 with --map of identify check"
        raise ConfigError(f"{known}: {names}", where=display_path(log))
    # A data file names its logs relative to its own folder.
    text = proposal_text(proposal, os.path.relpath(log.resolve(), out.resolve().parent))
    write_file(out, text.encode())
    if not options.quiet:
        # Who names the file reads it there.
        if options.out is None:
            print(text)
        else:
            print(_summary(proposal))
        for line in missing_channels(proposal):
            print(line)
        name = display_path(out)
        print(f"{name}: check each line, then\n  mirdrake identify check {name}\n  mirdrake identify {name}")
    return 0


def _summary(proposal: "DataProposal") -> str:
    """Return the number of channels and columns without one, and what is known of the vehicle."""
    lines = [f"{plural(len(proposal.channels), 'channel')}, {plural(len(proposal.others), 'column')} without a channel"]
    if (vehicle := proposal.vehicle) is not None:
        dimensions = f"wheelbase {vehicle.wheelbase:.4g} m, mass {vehicle.mass:.4g} kg"
        lines.append(f"vehicle '{vehicle.name}': {dimensions}, front length {vehicle.front_length:.4g} m")
    return "\n".join(lines)
