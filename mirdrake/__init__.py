"""mirdrake: model, simulate, identify and tune car-like vehicles with Drake.

::

    import mirdrake as mir

    spec = mir.load_diagram("bolt_test_track")
    run = mir.simulate(spec, duration=30)

Everything public is here, listed in ``__all__``. ``import mirdrake`` itself loads nothing: a name loads its module, and
with it Drake, when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

# The only list of the public names: type checkers read these imports, and so does __getattr__ at run time.
if TYPE_CHECKING:
    from mirdrake.assembly.diagram import load_diagram as load_diagram
    from mirdrake.assembly.diagram import make_diagram as make_diagram
    from mirdrake.batched import batch as batch
    from mirdrake.builder import Diagram as Diagram
    from mirdrake.builder import PathTracking as PathTracking
    from mirdrake.controllers import AckermannSteering as AckermannSteering
    from mirdrake.controllers import DiscretePid as DiscretePid
    from mirdrake.controllers import PathTracker as PathTracker
    from mirdrake.core.errors import MirdrakeError as MirdrakeError
    from mirdrake.editor import edit_world as edit_world
    from mirdrake.estimation import filter_bank as filter_bank
    from mirdrake.identification import check_data as check_data
    from mirdrake.identification import load_data as load_data
    from mirdrake.identification import load_identification as load_identification
    from mirdrake.identification.identify import identify as identify
    from mirdrake.importing.worlds import import_world as import_world
    from mirdrake.learning.data import driving_data as driving_data
    from mirdrake.plant.plant import add_vehicle as add_vehicle
    from mirdrake.plant.plant import add_world as add_world
    from mirdrake.plant.plant import make_plant as make_plant
    from mirdrake.report import write_report as write_report
    from mirdrake.runs.logs import Run as Run
    from mirdrake.runs.logs import load_run as load_run
    from mirdrake.runs.simulation import simulate as simulate
    from mirdrake.studies import run_study as run_study
    from mirdrake.suites import collect_cases as collect_cases
    from mirdrake.suites import run_suite as run_suite
    from mirdrake.tuning.tune import tune as tune
    from mirdrake.vehicles import load_vehicle as load_vehicle
    from mirdrake.world_checks import check_world as check_world
    from mirdrake.world_files import build_world as build_world
    from mirdrake.worlds import load_world as load_world


def public_modules() -> dict[str, str]:
    """Return the module of every public name, from the imports above."""
    import ast
    from pathlib import Path

    tree = ast.parse(Path(__file__).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


def __getattr__(name: str) -> Any:
    """Load a public name from its module when it is first used (PEP 562)."""
    if name.startswith("_") and name != "__all__":
        raise AttributeError(f"module 'mirdrake' has no attribute '{name}'")
    modules = public_modules()
    if name == "__all__":
        value: Any = sorted(modules)
    elif name in modules:
        value = getattr(import_module(modules[name]), name)
    else:
        raise AttributeError(f"module 'mirdrake' has no attribute '{name}'")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, whether they are loaded or not."""
    return sorted({*globals(), *public_modules(), "__all__"})
