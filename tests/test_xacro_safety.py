"""Hostile xacro files have no effect, and the features of ordinary ones work as in xacro."""

import ast
import copy
import math
import os
import random
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import xacro

from mirdrake.core.errors import ModelError
from mirdrake.vehicles.xacro_expressions import Evaluator
from mirdrake.vehicles.xacro_render import MACROS, render_xacro
from tests.timing import is_within

HEAD = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
LONGEST = 4.0
"""Processor time that a hostile file may take [s]."""


def escape(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def render(folder: Path, body: str, **options: Any) -> str:
    file = folder / "car.urdf.xacro"
    file.write_text(f"{HEAD}{body}</robot>", encoding="utf-8")
    return render_xacro(file, **options).text


def value(folder: Path, expression: str) -> str:
    """Return the value of an expression."""
    text = render(folder, f'<link name="${{{escape(expression)}}}"/>')
    return text.partition('name="')[2].partition('<link name="')[2].partition('"')[0]


# --- hostile expressions ---------------------------------------------------------------------------------------------

REACH = [
    "(lambda: 1)()",
    "(lambda f: f)(1)",
    "().__class__",
    "''.__class__.__mro__[1].__subclasses__()",
    "[c for c in ().__class__.__base__.__subclasses__()]",
    "(1).__class__",
    "math.__dict__",
    "math.__loader__",
    "xacro.__class__",
    "python.__class__",
    "python.type(1)",
    "python.type('X', (), {})",
    "python.vars()",
    "python.vars(math)",
    "python.hash('a')",
    "str.__subclasses__",
    "str.format.__self__",
    "str.mro()",
    "dict.fromkeys('ab').__class__",
    "int.from_bytes",
    "float.__init__",
    "'{0.__class__}'.format(1)",
    "'{0.__class__.__mro__}'.format('')",
    "'{a.__class__}'.format(a=1)",
    "'{0[0]}'.format([1])",
    "'{:{w.__class__}}'.format(1, w=2)",
    "'{0.real}'.format(1)",
    "'{}'.format_map({})",
    "f'{().__class__}'",
    "f'{(1).__class__.__name__!r}'",
    "f'{[].__class__:>{10}}'",
    "f'{math.__dict__}'",
    "(x for x in [1]).gi_frame",
    "(x for x in [1]).gi_frame.f_back.f_globals",
    "(x for x in [1]).gi_code",
    "[1].append.__self__",
    "[].append(1)",
    "[].extend([1])",
    "{}.update(a=1)",
    "{}.pop('a')",
    "{}.setdefault('a', 1)",
    "math.sin.__self__",
    "math.sin.__module__",
    "len.__self__",
    "max.__call__(1, 2)",
    "xacro.load_yaml.__globals__",
    "load_yaml.__globals__['os']",
    "xacro.load_yaml.__code__",
    "xacro.arg.__closure__",
    "xacro.dotify.__init__",
    "xacro.dotify({}).__class__",
    "xacro.dotify({'a': 1}).a.__class__",
    "xacro.dotify({'a': 1}).pop('a')",
    "xacro.YamlDictWrapper",
    "__import__('os').system('id')",
    "__builtins__",
    "__builtins__['eval']('1')",
    "globals()",
    "locals()",
    "eval('1')",
    "exec('1')",
    "compile('1', '', 'eval')",
    "open('/etc/passwd').read()",
    "input()",
    "getattr(1, 'real')",
    "setattr(math, 'pi', 3)",
    "breakpoint()",
    "os.system('id')",
    "sys.exit()",
    "(y := 5)",
    "[(y := x) for x in [1]]",
    "(yield)",
    "(yield from [1])",
    "(await x)",
    "[await x for x in [1]]",
    "b'abc'",
    "1j",
    "complex(1, 2)",
    "(-8) ** 0.5",
    "...",
    "print('x')",
    "sorted([1, 2], key=lambda x: -x)",
    "max([1, 2], key=xacro.fatal)",
    "map(lambda x: x, [1])",
    "list(map(eval, ['1']))",
    "filter(xacro.load_yaml, ['/etc/passwd'])",
    "dict(**{'a': 1})",
    "max(**{'a': 1})",
    "1 @ 2",
    "[x for x.y in [1]]",
    "[x for [x[0]] in [[1]]]",
    "xacro.fatal('stop')",
    "xacro.tokenize('a' * 40 + 'b', '](a+)+$')",
    "isinstance(1, str.__class__)",
    "math.pi.__class__",
    "math.pi.hex()",
    "(1).bit_length.__self__",
    "(1.5).as_integer_ratio()",
    "'abc'.encode()",
    "'a'.maketrans({})",
    "'abc'.translate({97: 'b'})",
    "slice(1)",
    "memoryview(b'')",
    "object()",
    "type",
    "super()",
    "NotImplemented",
    "Ellipsis",
    "xacro.load_yaml('/etc/passwd')",
    "xacro.load_yaml('/proc/self/environ')",
    "xacro.load_yaml('../../../../../../etc/hostname')",
    "xacro.load_yaml('~/.ssh/config')",
    "xacro.load_yaml('/dev/zero')",
    "load_yaml('/etc/passwd')",
]

GROW = [
    "9**9**9",
    "9**9**9**9",
    "2**1000000",
    "2**-1000000000000 * 2**1000000000",
    "(2**200)**200",
    "-9**999999",
    "(-9)**999999",
    "pow(9, 999999)",
    "1 << 10**9",
    "1 << (1 << 60)",
    "1 << (1 << 255)",
    "'a' * 10**10",
    "10**10 * 'a'",
    "[0] * 10**10",
    "(1, 2) * 10**9",
    "[[0] * 1000] * 10000",
    "[[[0] * 100] * 100] * 100",
    "'%1000000000d' % 1",
    "'%*d' % (1000000000, 1)",
    "'%.1000000000f' % 1.0",
    "'%(a)1000000000d' % {'a': 1}",
    "'{:1000000000}'.format(1)",
    "'{:{}}'.format(1, 1000000000)",
    "'{:>{w}}'.format(1, w=10**9)",
    "f'{1:1000000000}'",
    "f'{1:{10**9}}'",
    "f'{1.0:.1000000000f}'",
    "'a'.ljust(10**10)",
    "'a'.center(10**10)",
    "'1'.zfill(10**10)",
    "('a' * 99999).replace('a', 'b' * 99999)",
    "('a' * 99999).replace('', 'b' * 999)",
    "('a' * 50000).join(['b'] * 10000)",
    "','.join(['a' * 50000] * 10)",
    "range(10**10)",
    "list(range(10**9))",
    "range(1 << 200)",
    "range(-(1 << 200), 1 << 200)",
    "[x for x in range(99999) for y in range(99999)]",
    "[[y for y in range(1000)] for x in range(1000)]",
    "{x: list(range(1000)) for x in range(1000)}",
    "sum([[x] * 1000 for x in range(1000)], [])",
    "[1 for i in range(30000) if -1 in list(range(30000))]",
    "sum(1 for i in range(90000) for j in range(90000))",
    "list(map(range, [90000] * 1000))",
    "list(map(math.factorial, [1000] * 90000))",
    "list(filter(range, [90000] * 90000))",
    "sorted(range(9999), key=range)",
    "[range(90000), range(90000), range(90000)]",
    "[*range(90000), *range(90000)]",
    "max(*range(99999), *range(99999))",
    "dict(zip(range(99999), [list(range(99))] * 99999))",
    "math.factorial(10**8)",
    "math.factorial(10000)",
    "math.comb(10**8, 5 * 10**7)",
    "math.perm(10**8, 10**7)",
    "math.prod(range(1, 90000))",
    "math.lcm(*range(1, 90000))",
    "math.exp(10**5)",
    "math.ldexp(1.0, 10**12)",
    "round(1, -10**10)",
    "round(1.5, 10**10)",
    "int('9' * 90000)",
    "int('f' * 90000, 16)",
    "int('9' * 4000)",
    "1" * 4500,
    "+".join(["1"] * 4000),
    "(" * 3000 + "1" + ")" * 3000,
    "-" * 4000 + "1",
    "not " * 1000 + "1",
    "[" * 1500 + "]" * 1500,
    "x" * 6000,
    "'" + "a" * 6000 + "'",
    "str(list(range(99999)))",
    "repr('\\0' * 99999)",
    "('a' * 99999).split('a')",
    "list('a' * 99999 + 'b' * 99999)",
    "'a' * 60000 + 'b' * 60000",
]


@pytest.fixture(scope="module")
def evaluator() -> Evaluator:
    def rejected(name: str) -> Any:
        raise xacro.XacroException(name)

    return Evaluator(load_yaml=rejected, abs_filename=rejected, argument=rejected, warn=lambda text: None)


@pytest.mark.parametrize("expression", [*REACH, *GROW], ids=lambda text: text[:40])
def test_a_hostile_expression_has_no_value(expression, evaluator):
    """Also with a brace, which xacro's own syntax lets through in arguments only."""
    began = time.thread_time()
    with pytest.raises(
        (xacro.XacroException, NameError, SyntaxError, TypeError, ValueError, AttributeError, OverflowError)
    ):
        evaluator.evaluate(expression, {})
    assert is_within(time.thread_time() - began, LONGEST)


@pytest.mark.parametrize("expression", [*REACH, *GROW], ids=lambda text: text[:40])
def test_a_hostile_expression_is_an_error_in_time(expression, tmp_path):
    began = time.thread_time()
    with pytest.raises(ModelError) as caught:
        value(tmp_path, expression)
    assert is_within(time.thread_time() - began, LONGEST)
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 800
    assert "root:" not in text


FUNCTIONS_AS_TEXT = [
    "enumerate",
    "[map]",
    "xacro",
    "str(enumerate)",
    "repr([enumerate])",
    "str([(1, map)])",
    "'%s' % [map]",
    "'%s' % (map,)",
    "'{}'.format([map])",
    "'{!r}'.format((map,))",
    "f'{[map]}'",
    "str({1: map})",
    "xacro.message([map])",
]


@pytest.mark.parametrize("expression", FUNCTIONS_AS_TEXT)
def test_a_function_has_no_text(expression, evaluator):
    with pytest.raises(xacro.XacroException, match="a function has no text"):
        evaluator.evaluate(expression, {})


def test_no_error_contains_an_address_in_memory(tmp_path):
    with pytest.raises(ModelError, match=r"<function _map> is not in list") as caught:
        value(tmp_path, "[1].index(map)")
    assert "0x" not in str(caught.value)


def hostile_grammar(seed: int) -> str:
    """Return an expression of the building blocks of sandbox escapes."""
    source = random.Random(seed)
    atoms = ["()", "''", "[]", "{}", "(1)", "math", "xacro", "python", "str", "len", "xacro.load_yaml", "range", "0.5"]
    dunders = ["__class__", "__globals__", "__subclasses__()", "__mro__", "__dict__", "gi_frame", "f_back", "__init__"]
    atom = source.choice(atoms)
    for _ in range(source.randrange(1, 4)):
        atom += "." + source.choice(dunders)
    wraps = ["{}", "[{}]", "str({})", "f'{{{}}}'", "[x for x in {}]", "{{1: {}}}[1]", "({} if 1 else 2)", "not {}"]
    wraps += ["max(1, {})", "'%s' % {}", "'{{}}'.format({})", "list(map({}, [1]))", "({})()", "{}[0]", "1 and {}"]
    for _ in range(source.randrange(3)):
        atom = source.choice(wraps).format(atom)
    return atom


@pytest.mark.parametrize("block", range(10))
def test_no_generated_expression_reaches_an_attribute_of_python(block, evaluator):
    for seed in range(100 * block, 100 * block + 100):
        try:
            ast.parse(hostile_grammar(seed))
        except SyntaxError:  # quotes within quotes
            continue
        with pytest.raises((xacro.XacroException, NameError, TypeError, AttributeError)):
            evaluator.evaluate(hostile_grammar(seed), {})


def test_no_user_code_is_executed(tmp_path):
    target = tmp_path / "done"
    for expression in (
        f"(lambda: __import__('os').system('touch {target}'))()",
        f"[c for c in ().__class__.__base__.__subclasses__() if c.__name__ == '_wrap_close'][0].__init__.__globals__"
        f"['system']('touch {target}')",
    ):
        for body in (f'<link name="${{{escape(expression)}}}"/>', f'<link name="$(eval {escape(expression)})"/>'):
            with pytest.raises(ModelError):
                render(tmp_path, body)
    assert not target.exists()


# --- hostile files ---------------------------------------------------------------------------------------------------


def doubling(form: str, times: int = 40) -> str:
    first = '<xacro:property name="a0" value="lollollol"/>'
    lines = [f'<xacro:property name="a{i}" value="{form.format(i - 1)}"/>' for i in range(1, times)]
    return first + "".join(lines) + f'<link name="${{a{times - 1}}}"/>'


def calls(times: int = 30) -> str:
    """Macros of which each calls the one before it twice."""
    first = '<xacro:macro name="m0"><link name="x"/></xacro:macro>'
    lines = [f'<xacro:macro name="m{i}"><xacro:m{i - 1}/><xacro:m{i - 1}/></xacro:macro>' for i in range(1, times)]
    return first + "".join(lines) + f"<xacro:m{times - 1}/>"


def blocks(times: int = 30) -> str:
    first = '<xacro:property name="b0"><link name="x"/></xacro:property>'
    lines = [
        f'<xacro:property name="b{i}"><xacro:insert_block name="b{i - 1}"/><xacro:insert_block name="b{i - 1}"/>'
        "</xacro:property>"
        for i in range(1, times)
    ]
    return first + "".join(lines) + f'<xacro:insert_block name="b{times - 1}"/>'


BODIES = {
    "text doubles": doubling("${{a{0}}}${{a{0}}}"),
    "addition doubles": doubling("${{a{0} + a{0}}}"),
    "a list doubles": doubling("${{[a{0}, a{0}]}}"),
    "format doubles": doubling("${{'%s%s' % (a{0}, a{0})}}"),
    "macros double": calls(),
    "blocks double": blocks(),
    "a macro calls itself": '<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>',
    "macros call one another": '<xacro:macro name="m"><xacro:n/></xacro:macro><xacro:macro name="n"><xacro:m/>'
    "</xacro:macro><xacro:m/>",
    "a block inserts itself": '<xacro:property name="b"><xacro:insert_block name="b"/></xacro:property>'
    '<xacro:insert_block name="b"/>',
    "a property is itself": '<xacro:property name="a" value="${a}"/><link name="${a}"/>',
    "a chain of properties": '<xacro:property name="a0" value="1"/>'
    + "".join(f'<xacro:property name="a{i}" value="${{a{i - 1} + 1}}"/>' for i in range(1, 3000))
    + '<link name="${a2999}"/>',
    "a file includes itself": '<xacro:include filename="car.urdf.xacro"/>',
    "deep elements": "<a>" * 5000 + "</a>" * 5000,
    "slow expressions": '<link name="${sum(i for i in range(15000))}"/>' * 4000,
    "a device": '<xacro:include filename="/dev/zero"/>',
    "a pipe": '<xacro:include filename="pipe"/>',
    "not XML": '<xacro:include filename="/etc/passwd"/>',
    "$(env)": '<link name="$(env HOME)"/>',
    "$(eval)": '<link name="$(eval 9**9**9)"/>',
    "$(eval env)": "<link name=\"$(eval env('HOME'))\"/>",
    "$(eval class)": '<link name="$(eval ().__class__)"/>',
    "$(eval open)": "<link name=\"$(eval open('x'))\"/>",
    "$(command)": '<link name="$(command id)"/>',
    "$(anon)": '<link name="$(anon x)"/>',
}


@pytest.mark.parametrize("body", [pytest.param(body, id=name) for name, body in BODIES.items()])
def test_a_hostile_file_is_an_error_in_time(body, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    began = time.thread_time()
    with pytest.raises(ModelError) as caught:
        render(tmp_path, body)
    assert is_within(time.thread_time() - began, LONGEST)
    assert "\n" not in str(caught.value)
    assert "root:" not in str(caught.value)


def test_entities_are_an_error(tmp_path):
    file = tmp_path / "car.urdf.xacro"
    entities = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10 if i else "lol"}">' for i in range(12))
    file.write_text(f'<!DOCTYPE robot [{entities}]>\n<robot name="&l11;"/>', encoding="utf-8")
    with pytest.raises(ModelError, match=r"car.urdf.xacro:1: declares the XML entity 'l0'; write out"):
        render_xacro(file)
    file.write_text('<!DOCTYPE robot [<!ENTITY x SYSTEM "/etc/passwd">]>\n<robot name="&x;"/>', encoding="utf-8")
    with pytest.raises(ModelError, match="declares the XML entity 'x'"):
        render_xacro(file)


YAML = '<xacro:property name="c" value="${xacro.load_yaml(\'c.yaml\')}"/><link name="${c.a}"/>'


@pytest.mark.parametrize(
    "text",
    [
        "a: &a0 [x, x]\n" + "".join(f"b{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40)),
        "a: &a0 {x: 1}\n" + "".join(f"b{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}\n" for i in range(1, 40)),
        "&a [*a]",
        "a: !!python/object/apply:os.system ['id']",
        "a: !degrees 9**9**9",
        "a: !degrees (lambda: 1)()",
        "a: " + "9" * 5000,
        "[" * 3000,
        "- " * 3000 + "1",
        "a: [",
        "x" * 3_000_000,
        "- y\n" * 200_000,
    ],
    ids=lambda text: text[:20],
)
def test_a_hostile_yaml_file_is_an_error_in_time(text, tmp_path):
    (tmp_path / "c.yaml").write_text(text, encoding="utf-8")
    began = time.thread_time()
    with pytest.raises(ModelError) as caught:
        render(tmp_path, YAML)
    assert is_within(time.thread_time() - began, 4.0)
    assert "\n" not in str(caught.value)


def test_a_text_in_place_of_a_number_is_reported_with_its_place_in_the_yaml_file(tmp_path):
    (tmp_path / "c.yaml").write_text("drive: 5\nbrakes:\n  torque: 105.9 N m\n", encoding="utf-8")
    body = """<xacro:property name="values" value="${xacro.load_yaml('c.yaml')}"/>
        <xacro:property name="torque" value="${values.brakes.torque}"/><link name="${torque * 0.5}"/>"""
    with pytest.raises(ModelError, match=r"torque is text '105\.9 N m' \(\S*c\.yaml:3: brakes\.torque\), not a number"):
        render(tmp_path, body)


def test_yaml_is_read_in_the_package_and_in_packages_that_were_found(tmp_path):
    (tmp_path / "car" / "urdf").mkdir(parents=True)
    (tmp_path / "car" / "config").mkdir()
    (tmp_path / "other").mkdir()
    for folder in ("car/config", "other", "."):
        (tmp_path / folder / "c.yaml").write_text("{a: five}", encoding="utf-8")
    urdf = tmp_path / "car" / "urdf"
    assert "five" in render(urdf, YAML.replace("c.yaml", "../config/c.yaml"))
    with pytest.raises(ModelError, match=r"c.yaml is outside of the vehicle's package .*car"):
        render(urdf, YAML.replace("c.yaml", "../../c.yaml"))
    (urdf / "link.yaml").symlink_to(tmp_path / "c.yaml")
    with pytest.raises(ModelError, match="outside of the vehicle's package"):
        render(urdf, YAML.replace("c.yaml", "link.yaml"))
    text = YAML.replace("c.yaml", "$(find other)/c.yaml")
    assert "five" in render(urdf, text, find=lambda name: tmp_path / name)


def test_environment_variables_are_read_only_if_they_are_listed(tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET", "s3cret")
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    assert "jazzy" in render(tmp_path, '<link name="$(env ROS_DISTRO)"/>')
    with pytest.raises(ModelError, match="'SECRET' is not read; allow it with MIRDRAKE_XACRO_ENV=SECRET"):
        render(tmp_path, '<link name="$(env SECRET)"/>')
    file = tmp_path / "car.urdf.xacro"
    file.write_text(f'{HEAD}<link name="$(optenv SECRET of its own)"/></robot>', encoding="utf-8")
    urdf = render_xacro(file)
    assert "s3cret" not in urdf.text
    assert 'name="of its own"' in urdf.text
    assert "is not read" in urdf.warnings[0].text
    monkeypatch.setenv("MIRDRAKE_XACRO_ENV", "OTHER, SECRET")
    assert "s3cret" in render(tmp_path, '<link name="$(env SECRET)"/>')


# --- what ordinary files use -----------------------------------------------------------------------------------------

ORDINARY = [
    "wheelbase / 2",
    "-wheelbase/2 + 0.1",
    "radians(90)",
    "degrees(pi)",
    "math.radians(45) * 2",
    "sin(pi/6)",
    "cos(0) + tan(0)",
    "atan2(1, 2)",
    "sqrt(2)",
    "hypot(3, 4)",
    "math.pow(2, 0.5)",
    "2**3",
    "2**0.5",
    "10**-3",
    "(0.0833333 * mass) * (width*width + height*height)",
    "mass / 12.0 * (3 * radius**2 + length**2)",
    "1e-3 * mass",
    "7 // 2",
    "7 % 3",
    "-7 % 3",
    "abs(-2)",
    "python.abs(-2.5)",
    "max(1, 2.5)",
    "min([3, 1, 2])",
    "round(2.567, 2)",
    "round(2.5)",
    "int(2.7)",
    "int('12')",
    "float('1.5') * 2",
    "str(5) + 'mm'",
    "bool(0)",
    "len('abc')",
    "len([1, 2, 3])",
    "prefix + '_link'",
    "prefix + str(3)",
    "prefix != ''",
    "prefix == 'front' and mass > 3",
    "not use_sim",
    "use_sim or mass",
    "use_sim",
    "'a' if mass > 3 else 'b'",
    "1 if use_sim else 0",
    "'front' in prefix",
    "3 in [1, 2, 3]",
    "mass not in (1, 2)",
    "1 < mass < 100",
    "None is None",
    "[1, 2, 3][1]",
    "'a b c'.split()[1]",
    "'a,b'.split(',')[0]",
    "prefix.split('_')[-1]",
    "prefix.upper()",
    "prefix.startswith('fr')",
    "prefix.replace('f', 'F')",
    "'x'.join(['a', 'b'])",
    "prefix[0]",
    "prefix[1:3]",
    "prefix[::-1]",
    "'%.3f' % pi",
    "'%s_%d' % (prefix, 2)",
    "'%05.1f %% in 2026' % 3.14159",
    "'%(a)s' % {'a': 1}",
    "'{}_{}'.format(prefix, 2)",
    "'{:.2f}'.format(pi)",
    "'{0}{1}{0}'.format('a', 'b')",
    "'{name}'.format(name=prefix)",
    "f'{prefix}_{mass:.1f}'",
    "f'{mass!r}'",
    "{'a': 1, 'b': 2}['b']",
    "dict(a=1, b=2)['a']",
    "[x * 2 for x in [1, 2]]",
    "[x for x in range(5) if x % 2]",
    "python.sum([1, 2, 3])",
    "python.sum([1.5, 2])",
    "list(range(3))",
    "python.list(python.range(2, 8, 3))",
    "sorted([3, 1, 2])",
    "list(map(float, ['1', '2']))",
    "[i for i, v in python.enumerate(['a', 'b'])]",
    "list(python.zip([1, 2], [3, 4]))",
    "python.any([0, 1])",
    "python.isinstance(mass, float)",
    "python.isinstance(prefix, str)",
    "xacro.arg('count')",
    "int(xacro.arg('count')) + 1",
    "python.tuple([1, 2]) + (3,)",
    "[1] + [2]",
    "'-' * 5",
    "[0] * 3",
    "1 << 4",
    "6 & 3 | 8",
    "~5",
    "+mass",
    "0.1 + 0.2",
    "1e300 * 10",
    "floor(2.7)",
    "ceil(2.1)",
    "fabs(-3)",
    "math.factorial(5)",
    "math.gcd(12, 18)",
    "math.copysign(1, -2)",
    "math.inf",
    "e",
    "config['wheel']['radius']",
    "config.wheel.radius",
    "config.wheel.radius * 2",
    "config['names'][1]",
    "config.names[0]",
    "config.angle",
    "config.wheel.get('radius')",
    "config.get('none', 7)",
    "[n for n in config.names]",
    "list(config.wheel.keys())",
    "config.inner[0].x",
    "'wheel' in config",
    "len(config.names)",
    "xacro.tokenize('a,b;c')",
    "xacro.dotify({'a': 1}).a",
]

PROPERTIES = """
<xacro:arg name="count" default="4"/>
<xacro:property name="wheelbase" value="2.6"/><xacro:property name="mass" value="12.5"/>
<xacro:property name="width" value="0.3"/><xacro:property name="height" value="${width / 2}"/>
<xacro:property name="radius" value="${wheelbase / 8}"/><xacro:property name="length" value="0.1"/>
<xacro:property name="prefix" value="front_left"/><xacro:property name="use_sim" value="true"/>
<xacro:property name="config" value="${xacro.load_yaml('c.yaml')}"/>
"""
CONFIG = "{wheel: {radius: 0.31, width: 0.2}, names: [a, b], angle: !degrees 90, inner: [{x: 4}]}"


def test_features_of_ordinary_files_work_as_in_xacro(tmp_path):
    (tmp_path / "c.yaml").write_text(CONFIG, encoding="utf-8")
    file = tmp_path / "car.urdf.xacro"
    links = "".join(f'<link name="${{{escape(text)}}}"/>\n' for text in ORDINARY if "}" not in text)
    file.write_text(f"{HEAD}{PROPERTIES}{links}</robot>", encoding="utf-8")
    # xacro has no global `abs`; its `python` namespace has.
    plain = file.with_name("plain.xacro")
    plain.write_text(file.read_text(encoding="utf-8").replace('"${abs(', '"${python.abs('), encoding="utf-8")
    expected = xacro.process_file(str(plain), mappings={})
    names = [element.getAttribute("name") for element in expected.getElementsByTagName("link")]
    assert [link.get("name") for link in render_xacro(file).root] == names
    assert len(names) > 90


@pytest.mark.parametrize("text", [text for text in ORDINARY if "{" in text])
def test_an_expression_with_braces_gives_what_python_gives(text, evaluator):
    names = {"prefix": "front", "mass": 12.5}
    assert evaluator.evaluate(text, {}, names=names) == eval(text, {**names, "pi": math.pi, "xacro": _Dotify})


class _Dotify:
    dotify = xacro.YamlDictWrapper


def test_loops_of_macros_are_as_deep_as_they_are_in_public_files(tmp_path):
    text = render(
        tmp_path,
        '<xacro:macro name="loop" params="i"><link name="l${i}"/>'
        f'<xacro:if value="${{i &lt; {MACROS - 50}}}"><xacro:loop i="${{i+1}}"/></xacro:if>'
        '</xacro:macro><xacro:loop i="1"/>',
    )
    assert f'"l{MACROS - 50}"' in text


def test_the_expansion_leaves_xacro_as_it_was(tmp_path):
    before = copy.copy(vars(xacro))
    with pytest.raises(ModelError):
        value(tmp_path, "9**9**9")
    value(tmp_path, "1 + 1")
    changed = {name for name, item in vars(xacro).items() if before.get(name) is not item}
    assert changed <= {"filestack", "macrostack", "verbosity", "all_includes"}


def made_expressions(seed: int) -> Iterator[str]:
    """Arithmetic, text and comparisons at random, within Python's own bounds."""
    source = random.Random(seed)

    def number(depth: int) -> str:
        if depth == 0 or source.random() < 0.3:
            return source.choice(["1", "2.5", "mass", "pi", "0", "-3", "config.wheel.radius", "len(prefix)"])
        kind = source.randrange(6)
        a, b = number(depth - 1), number(depth - 1)
        return [f"({a} + {b})", f"({a} * {b})", f"({a} - {b})", f"max({a}, {b})", f"({a} if {b} > 1 else {b})",
                f"round({a}, 3)"][kind]  # fmt: skip

    for _ in range(100):
        operand = number(4)
        yield source.choice(
            [
                operand,
                f"str({operand})",
                f"'%.4f' % ({operand})",
                f"[{operand}, 2][0]",
                f"{operand} > 1 and {operand} < 5",
            ]
        )


def test_generated_expressions_evaluate_as_in_xacro(tmp_path):
    (tmp_path / "c.yaml").write_text(CONFIG, encoding="utf-8")
    file = tmp_path / "car.urdf.xacro"
    links = "".join(f'<link name="${{{escape(text)}}}"/>' for text in made_expressions(5))
    file.write_text(f"{HEAD}{PROPERTIES}{links}</robot>", encoding="utf-8")
    expected = xacro.process_file(str(file), mappings={}).getElementsByTagName("link")
    assert [link.get("name") for link in render_xacro(file).root] == [
        element.getAttribute("name") for element in expected
    ]
