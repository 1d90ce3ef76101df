"""Load a vehicle folder with all its variants: a program for a separate process, which a damaged mesh may end."""

import sys
from pathlib import Path

from mirdrake.core.errors import MirdrakeError, first_line
from mirdrake.vehicles.vehicle import load_vehicle, variants


def main() -> int:
    """Load the folder that the command line names."""
    folder = Path(sys.argv[1])
    try:
        load_vehicle(str(folder))
        for variant in variants(folder):
            load_vehicle(f"{folder}@{variant}")
    except MirdrakeError as error:
        sys.stderr.write(f"{first_line(error)}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
