"""mirdrake: model, simulate, identify and tune car-like vehicles with Drake.

::

    import mirdrake as mir

    spec = mir.load_diagram("bolt_test_track")
    run = mir.simulate(spec, duration=30)

Everything public is here, listed in ``__all__``. ``import mirdrake`` itself loads nothing: a name brings in its module,
and with it Drake, when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mirdrake.assembly.diagram import load_diagram, make_diagram
    from mirdrake.controllers import AckermannSteering, DiscretePid, PathTracker
    from mirdrake.core.errors import MirdrakeError
    from mirdrake.identification import check_data, load_data, load_identification
    from mirdrake.identification.identify import identify
    from mirdrake.importing.worlds import import_world
    from mirdrake.plant.plant import add_vehicle, add_world, make_plant
    from mirdrake.report import write_report
    from mirdrake.runs.logs import Run, load_run
    from mirdrake.runs.simulation import simulate
    from mirdrake.studies import run_study
    from mirdrake.suites import collect_cases, run_suite
    from mirdrake.tuning.tune import tune
    from mirdrake.vehicles import load_vehicle
    from mirdrake.world_checks import check_world
    from mirdrake.world_files import build_world
    from mirdrake.worlds import load_world

__all__ = [  # the order of code points, capitals first; every name also stands in the imports above and in _HOME below
    "AckermannSteering",
    "DiscretePid",
    "MirdrakeError",
    "PathTracker",
    "Run",
    "add_vehicle",
    "add_world",
    "build_world",
    "check_data",
    "check_world",
    "collect_cases",
    "identify",
    "import_world",
    "load_data",
    "load_diagram",
    "load_identification",
    "load_run",
    "load_vehicle",
    "load_world",
    "make_diagram",
    "make_plant",
    "run_study",
    "run_suite",
    "simulate",
    "tune",
    "write_report",
]

_HOME = {
    "AckermannSteering": "controllers",
    "DiscretePid": "controllers",
    "MirdrakeError": "core.errors",
    "PathTracker": "controllers",
    "Run": "runs.logs",
    "add_vehicle": "plant.plant",
    "add_world": "plant.plant",
    "build_world": "world_files",
    "check_data": "identification",
    "check_world": "world_checks",
    "collect_cases": "suites",
    "identify": "identification.identify",
    "import_world": "importing.worlds",
    "load_data": "identification",
    "load_diagram": "assembly.diagram",
    "load_identification": "identification",
    "load_run": "runs.logs",
    "load_vehicle": "vehicles",
    "load_world": "worlds",
    "make_diagram": "assembly.diagram",
    "make_plant": "plant.plant",
    "run_study": "studies",
    "run_suite": "suites",
    "simulate": "runs.simulation",
    "tune": "tuning.tune",
    "write_report": "report",
}


def __getattr__(name: str) -> Any:
    """A public name, from its module, at its first use (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'mirdrake' has no attribute '{name}'")
    value = getattr(import_module(f"mirdrake.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names, also those not loaded yet."""
    return sorted({*globals(), *__all__})
