"""Cost of actors: a hundred of them in a drive, and a scan of a lidar among thirty moving cars.

    python benchmarks/actors.py [--pairs 5] [--scans 60]

Drives with and without actors alternate in one process, and so do scans; figures are medians of processor times.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from functools import partial
from math import tau
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import yaml

from benchmarks.timing import machine, timed
from mirdrake.assembly.diagram import assemble
from mirdrake.core.paths import find
from mirdrake.core.yaml_io import read_tree
from mirdrake.runs.simulation import Simulation

DURATION = 10.0  # [s] of a drive
COLUMNS = 900  # of 16 planes, over 30 degrees of elevation
LIDAR = {"preset": "velodyne_vlp16", "columns": COLUMNS, "rate": 10.0, "noise": 0.0}


def crowd() -> list[dict[str, Any]]:
    """Return 80 cars in the four streets of `city_block_grid` and 20 pedestrians who cross them."""
    car: dict[str, Any] = {"actor": "sedan | van", "speed": "6 .. 10", "behaviour": "idm"}
    cars = [
        car | {"name": street, "along": {"track": street, "s": 4, "spacing": 11.6, "count": 20}}
        for street in ("south", "north", "west", "east")
    ]
    walker: dict[str, Any] = {"actor": "pedestrian", "speed": "1.0 .. 1.6", "behaviour": "walk"}
    walkers = [
        walker | {"name": f"walker_{k}", "path": [[x, y - 9.0], [x, y + 9.0]]}
        for k, (x, y) in enumerate((-52.0 + 22.0 * (k % 10), 30.0 + 60.0 * (k // 10)) for k in range(20))
    ]
    return cars + walkers


def _file(world: dict[str, Any]) -> str:
    """Return the path of a new file with a world."""
    path = Path(tempfile.mkdtemp()) / "actors.yaml"
    path.write_text(yaml.safe_dump(world), encoding="utf-8")
    return str(path)


def drive(contact: str, actors: list[dict[str, Any]]) -> Simulation:
    """Return a drive of 10 s with one car in `city_block_grid`, without sensors."""
    data, _ = read_tree(find("worlds", "city_block_grid"))
    spec = {
        "world": _file(data | {"actors": actors, "tests": []}),
        "vehicles": {"ego": {"model": "bolt", "start": "west"}},
        "control": {"ego": {"kind": "constant", "speed": 5.0}},
        "plant": {"contact": contact},
        "record": {"meshcat": False, "report": False},
    }
    return Simulation(assemble(spec))


def cost(contact: str, pairs: int) -> dict[str, float]:
    """Return the processor times of a drive without and with actors [s], and the median of the ratios of the pairs."""
    times: list[tuple[float, float]] = []
    drives = [drive(contact, []), drive(contact, crowd())]
    for pair in range(pairs + 1):
        # The order changes from pair to pair; the first pair compiles.
        order = (0, 1) if pair % 2 else (1, 0)
        found = {number: timed(partial(drives[number].run, duration=DURATION)).cpu for number in order}
        times.append((found[0], found[1]))
    without, with_actors = zip(*times[1:], strict=True)
    ratios = [b / a - 1.0 for a, b in times[1:]]
    return {
        "without_s": median(without),
        "with_s": median(with_actors),
        "more_percent": 100.0 * median(ratios),
        "least_percent": 100.0 * min(ratios),
        "most_percent": 100.0 * max(ratios),
    }


def scan(actors: list[dict[str, Any]], scans: int) -> Callable[[], list[float]]:
    """Return a function that measures the processor times of scans [ms], half a second into a run."""
    spec = {
        "world": _file({"mirdrake": "world/1", "name": "cars", "actors": actors}),
        "vehicles": {"ego": {"model": "bolt", "start": {"x": 0, "y": 0}, "speed": 5, "mounts": {"roof_lidar": LIDAR}}},
        "control": {"ego": {"kind": "constant", "speed": 5.0}},
        "sensors": {"ego": ["roof_lidar"]},
        "plant": {"contact": "point"},
        "record": {"meshcat": False, "report": False},
    }
    simulation = Simulation(assemble(spec))
    sensor: Any = simulation.assembly.diagram.GetSubsystemByName("ego.roof_lidar")
    contexts: list[Any] = []

    def keep(context: Any) -> None:
        if not contexts and context.get_time() >= 0.5:
            contexts.append(context.Clone())

    simulation.run(duration=0.6, monitor=keep)
    own = sensor.GetMyContextFromRoot(contexts[0])

    def measure() -> list[float]:
        found = []
        for _ in range(scans):
            began = time.process_time()
            sensor.look(own)
            found.append(1e3 * (time.process_time() - began))
        return found

    return measure


def ring() -> list[dict[str, Any]]:
    """Return 30 cars between 8 m and 60 m around the sensor, each on a straight path at 8 m/s to 14 m/s."""
    generator = np.random.default_rng(7)
    cars = []
    for k in range(30):
        angle, away = tau * k / 30.0, generator.uniform(8.0, 60.0)
        x, y = away * np.cos(angle), away * np.sin(angle)
        heading = angle + tau / 4.0
        path = [[float(x + d * np.cos(heading)), float(y + d * np.sin(heading))] for d in (-5.0, 60.0)]
        speed = float(generator.uniform(8.0, 14.0))
        cars.append({"actor": "sedan", "name": f"car_{k:02d}", "path": path, "speed": speed})
    return cars


def scans(count: int) -> dict[str, float]:
    """Return the medians of a scan without and with 30 moving cars [ms]; groups of ten scans alternate."""
    empty, full = scan([], 10), scan(ring(), 10)
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(max(count // 10, 1)):
        times[0].extend(empty())
        times[1].extend(full())
    return {"alone_ms": median(times[0]), "among_30_cars_ms": median(times[1])}


def main() -> None:
    """Print all figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--scans", type=int, default=60)
    options = parser.parse_args()
    result: dict[str, Any] = {"machine": machine(), "lidar_16x900": scans(options.scans)}
    for contact in ("point", "hydroelastic"):
        result[f"100_actors_{contact}"] = cost(contact, options.pairs)
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
