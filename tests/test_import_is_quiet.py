"""``import mirdrake`` is fast and prints nothing: no Drake, no plotting, no network, no text."""

import json
import statistics
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
HEAVY = ("pydrake", "numpy", "matplotlib", "pandas", "scipy", "pyarrow", "pydantic", "trimesh", "meshcat", "tqdm")

LOOK = """
import json, sys, time
events = []
sys.addaudithook(lambda event, arguments: events.append(event) if event.startswith("socket.") else None)
start = time.perf_counter()
import mirdrake
seconds = time.perf_counter() - start
json.dump({"seconds": seconds, "modules": sorted(sys.modules), "events": events}, sys.stderr)
"""


@pytest.fixture(scope="module")
def looks() -> list[dict[str, object]]:
    """Return the modules of three fresh interpreters; each must print nothing on its standard output."""
    results = []
    for _ in range(3):
        done = subprocess.run([sys.executable, "-W", "error", "-c", LOOK], cwd=ROOT, capture_output=True, text=True)
        assert (done.returncode, done.stdout) == (0, ""), done.stderr
        results.append(json.loads(done.stderr))  # fails on any other text
    return results


def test_import_takes_less_than_three_tenths_of_a_second(looks: list[dict[str, float]]) -> None:
    assert statistics.median(look["seconds"] for look in looks) < 0.3


def test_import_loads_no_heavy_package(looks: list[dict[str, list[str]]]) -> None:
    loaded = {module.split(".")[0] for module in looks[0]["modules"]}
    assert loaded.isdisjoint(HEAVY)


def test_import_opens_no_socket(looks: list[dict[str, list[str]]]) -> None:
    assert looks[0]["events"] == []


def test_errors_and_paths_come_without_drake() -> None:
    code = (
        "import sys, mirdrake.core.errors, mirdrake.core.paths, mirdrake.core.yaml_io; print('pydrake' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("False\n", "")


@pytest.mark.parametrize("words", [["--version"], ["--help"], ["world", "--help"]], ids=" ".join)
def test_version_and_help_load_no_heavy_package(words: list[str]) -> None:
    code = (
        "import sys; from mirdrake.cli import main\n"
        f"try: main({words})\n"
        "except SystemExit: pass\n"
        f"print([name for name in {HEAVY} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (done.stdout.splitlines()[-1], done.stderr) == ("[]", "")


def test_a_verb_imports_its_own_module_alone() -> None:
    code = (
        "import sys; from mirdrake.cli import main\n"
        "try: main(['replay', '--help'])\n"
        "except SystemExit: pass\n"
        "from mirdrake.cli import VERBS; from mirdrake.cli.verbs import modules\n"
        "print(sorted(name for _, name in modules(VERBS) if f'mirdrake.cli.{name}' in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (done.stdout.splitlines()[-1], done.stderr) == ("['replay']", "")


def test_every_verb_can_be_imported_and_has_a_help_line_and_an_example() -> None:
    from importlib import import_module

    from mirdrake.cli import VERBS
    from mirdrake.cli.verbs import Verb, modules

    def check(verbs: dict[str, Verb], above: str) -> None:
        for name, verb in verbs.items():
            assert verb.help
            more = verb.more if verb.verbs else import_module(f"mirdrake.cli.{verb.module}").MORE
            assert f"mirdrake {above}{name}" in more or above + name in {"identify run", "tune run"}, name
            check(dict(verb.verbs), f"{above}{name} ")

    check(VERBS, "")
    names = [module for _, module in modules(VERBS)]
    assert len(set(names)) == len(names)


def test_the_version_comes_without_drake_and_numpy() -> None:
    code = (
        "import sys, contextlib; from mirdrake.cli import main\n"
        "with contextlib.suppress(SystemExit): main(['--version'])\n"
        f"print(sorted({set(HEAVY)} & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stderr == "[]\n"
    assert done.stdout.startswith("mirdrake")


def test_the_modules_of_verbs_load_what_they_need_when_they_run() -> None:
    """`new` may load Drake, as its options are the dimensions of a vehicle; `checking` does the work of `check`."""
    modules = [f"mirdrake.cli.{file.stem}" for file in (ROOT / "mirdrake" / "cli").glob("[a-z]*.py")]
    code = (
        "import sys, importlib, json; loaded = {}\n"
        "for name in json.loads(sys.argv[1]):\n"
        f"    importlib.import_module(name); loaded[name] = sorted({set(HEAVY)} & set(sys.modules))\n"
        "print(json.dumps(loaded))"
    )
    names = sorted(set(modules) - {"mirdrake.cli.new", "mirdrake.cli.checking"})
    done = subprocess.run([sys.executable, "-c", code, json.dumps(names)], cwd=ROOT, capture_output=True, text=True)
    loaded = json.loads(done.stdout)
    assert {name for name, heavy in loaded.items() if set(heavy) - {"pydantic"}} == set()


def test_the_world_editor_opens_without_plant_and_drawing() -> None:
    """A map of 400 props is to be seen within 2 s; these imports alone took 1 s of it."""
    code = (
        "import sys, mirdrake.editor.editor\n"
        "print(sorted({'pandas', 'trimesh', 'numba', 'mirdrake.assembly', 'mirdrake.plant'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("[]\n", "")


def test_the_report_of_an_identification_comes_without_manoeuvres() -> None:
    """Their model of Drake, which only the report of a run needs, took 1 s of processor time of each identification."""
    code = "import sys, mirdrake.report.identification; print('mirdrake.manoeuvres' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("False\n", "")


def test_a_deferred_name_is_found_and_an_unknown_one_is_an_error() -> None:
    from mirdrake import batched, report, single_track, viewer, world_checks

    for package in (batched, report, single_track, viewer, world_checks):
        assert all(hasattr(package, name) for name in package.__all__)
        with pytest.raises(AttributeError, match=f"module '{package.__name__}' has no attribute 'nothing'"):
            _ = package.nothing
