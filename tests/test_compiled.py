"""Machine code: records of numbers, functions that call others, and conditions of recompilation."""

import importlib
import runpy
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba.core.caching import CompileResultCacheImpl

from mirdrake.core import compiled as machine
from mirdrake.core.compiled import compiled, plain, record_type, records
from mirdrake.core.maths import absolute, choose, wrap_angle


class Spring(NamedTuple):
    stiffness: float
    ends: tuple[float, float]


@dataclass(frozen=True)
class Damper:
    rate: float


class Strut(NamedTuple):
    spring: Spring
    damper: Damper
    joint: int
    broken: bool
    force: Any = 0.0


STRUT = Strut(Spring(2000.0, (0.1, 0.4)), Damper(50.0), 3, False, 9.0)


def test_a_record_has_the_fields_of_its_class_and_of_those_within():
    (strut,) = records(Strut, [STRUT])
    assert strut.dtype == record_type(Strut)
    assert strut["spring"]["ends"].tolist() == [0.1, 0.4]
    assert (strut["damper"]["rate"], strut["joint"], strut["broken"], strut["force"]) == (50.0, 3, False, 9.0)
    assert plain(STRUT) == ((2000.0, (0.1, 0.4)), (50.0,), 3, False, 9.0)


def pull(strut, length):
    return strut.spring.stiffness * (length - strut.spring.ends[0])


def double(strut, length):
    return 2.0 * pull(strut, length)


def pull_all(law, struts, lengths, forces):
    for i in range(len(struts)):
        struts[i].force = law(struts[i], lengths[i])
        forces[i] = struts[i].force + struts[i].damper.rate


def test_a_function_and_what_it_calls_are_compiled_with_a_law():
    struts, forces = records(Strut, [STRUT, STRUT]), np.zeros(2)
    for law, times in ((pull, 1.0), (double, 2.0)):
        compiled(pull_all, law, parts=(pull,))(struts, np.array([0.2, 0.3]), forces)
        assert forces == pytest.approx([50.0 + times * 200.0, 50.0 + times * 400.0])
        assert struts["force"] == pytest.approx([times * 200.0, times * 400.0])
    assert compiled(pull_all, pull, parts=(pull,)) is compiled(pull_all, pull, parts=(pull,))


def wrap_all(angles, wrapped, sizes):
    for i in range(len(angles)):
        wrapped[i] = wrap_angle(angles[i])
        sizes[i] = absolute(angles[i])


def test_angles_and_sizes_are_bit_equal_to_those_of_python():
    half = np.pi * np.arange(-9.0, 10.0)
    near = np.concatenate([half, np.nextafter(half, np.inf), np.nextafter(half, -np.inf), [-0.0, 1e-310, 1e17]])
    angles = np.concatenate([near, np.random.default_rng(1).uniform(-50.0, 50.0, 1000)])
    wrapped, sizes = np.empty_like(angles), np.empty_like(angles)
    compiled(wrap_all, parts=())(angles, wrapped, sizes)
    assert wrapped.tobytes() == np.array([wrap_angle(angle) for angle in angles.tolist()]).tobytes()
    assert sizes.tobytes() == np.abs(angles).tobytes()


def test_values_are_chosen_element_by_element_of_arrays_of_numpy():
    x = np.array([-1.0, 0.0, 2.0])
    assert choose(x < 0.0, -x, x).tolist() == [1.0, 0.0, 2.0]
    assert (choose(True, 1.0, 2.0), choose(np.False_, 1.0, 2.0)) == (1.0, 2.0)


def test_where_nothing_can_be_written_it_is_compiled_all_the_same(monkeypatch):
    monkeypatch.setattr(CompileResultCacheImpl, "_locator_classes", [])
    machine._compiled.cache_clear()
    forces = np.zeros(1)
    compiled(pull_all, pull, parts=(pull,))(records(Strut, [STRUT]), np.array([0.2]), forces)
    assert forces == pytest.approx([250.0])


def test_cached_code_of_a_class_that_was_renamed_is_no_obstacle(tmp_path, monkeypatch):
    """As after an update: the function's file is the same, the class among its former arguments is gone."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "updated_law.py").write_text("def first(pair):\n    return pair[0]\n", encoding="utf-8")
    for name in ("Before", "Afterwards"):
        text = f"from typing import NamedTuple\n\nclass {name}(NamedTuple):\n    size: float\n"
        (tmp_path / "updated_kinds.py").write_text(text, encoding="utf-8")
        for module in ("updated_law", "updated_kinds"):
            monkeypatch.delitem(sys.modules, module, raising=False)
        importlib.invalidate_caches()
        law, kinds = (importlib.import_module(module) for module in ("updated_law", "updated_kinds"))
        function: Any = compiled(law.first, parts=())
        assert function(getattr(kinds, name)(2.0)) == 2.0
        assert function._cache_misses
        assert Path(function._cache.cache_path).is_relative_to(tmp_path)


def test_kept_code_is_read_without_the_compiler_which_is_prepared_when_something_is_compiled(tmp_path):
    script = tmp_path / "steps.py"
    script.write_text(
        "import sys\nfrom mirdrake.core.compiled import compiled\n\n\n"
        "def square(x):\n    return x * x\n\n\ndef sums(x):\n    return x.sum() + x.mean()\n\n\n"
        "function = compiled(square, parts=())\n"
        "print(function(3.0), sum(function._cache_hits.values()), 'numba.np.arraymath' in sys.modules)\n"
        "if len(sys.argv) > 1:\n    import numpy as np\n    print(compiled(sums, parts=())(np.ones(3)))\n",
        encoding="utf-8",
    )
    calls = [[], [], ["compile"]]
    outputs = [
        subprocess.run([sys.executable, str(script), *more], capture_output=True, text=True, check=True).stdout.split()
        for more in calls
    ]
    assert outputs == [["9.0", "0", "True"], ["9.0", "1", "False"], ["9.0", "1", "False", "4.0"]]


def test_kept_code_is_of_another_version_when_the_source_of_any_part_changes(tmp_path):
    path = tmp_path / "part.py"

    def version_of(text):
        path.write_text(text, encoding="utf-8")
        return machine._version([pull_all, runpy.run_path(str(path))["part"]])

    first, second = version_of("def part(x):\n    return x\n"), version_of("def part(x):\n    return 1.0 * x\n")
    assert first == version_of("def part(x):\n    return x\n") != second
