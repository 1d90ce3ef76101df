"""``mirdrake inspect``: figures of a vehicle, and implausible values."""

import argparse
import json
from pathlib import Path

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import display_path

MORE = """\
examples:
  mirdrake inspect bolt
  mirdrake inspect bolt --out bolt.html      a report with drawings to scale; opens offline
  mirdrake inspect bolt --out links.svg      links and joints as a picture
  mirdrake inspect bolt --json               the same figures as data"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument("vehicle", help="name or path of a vehicle; bolt@published is a variant")
    parser.add_argument("--json", action="store_true", help="print data instead of text")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help=".html: report; .svg or .dot: graph of links and joints; .json: figures",
    )
    parser.add_argument("--strict", action="store_true", help="exit with 1 if there is a warning")


def run(options: argparse.Namespace) -> int:
    """Print the figures of the vehicle."""
    from mirdrake.core.files import write_file
    from mirdrake.report.inspection_text import describe, draw_links, write_links_dot
    from mirdrake.vehicles import load_vehicle
    from mirdrake.vehicles.inspection import inspect_vehicle

    # Checked first, as the inspection takes seconds.
    out: Path | None = options.out
    if out is not None and out.suffix not in {".html", ".svg", ".dot", ".json"}:
        raise ConfigError(f"--out {out}: the name must end in .html, .svg, .dot or .json")
    vehicle = load_vehicle(options.vehicle)
    figures = inspect_vehicle(vehicle)
    data = json.dumps(figures.to_dict(), indent=2, ensure_ascii=False)
    print(data if options.json else describe(figures))
    if out is not None:
        if out.suffix == ".html":
            from mirdrake.report.inspection import render_inspection  # Matplotlib takes half a second

            text = render_inspection(figures, vehicle)
        elif out.suffix == ".json":
            text = data + "\n"
        else:
            text = draw_links(figures) if out.suffix == ".svg" else write_links_dot(figures)
        write_file(out, text)
        if not options.json:
            print(display_path(out))
    return 1 if options.strict and figures.warnings else 0
