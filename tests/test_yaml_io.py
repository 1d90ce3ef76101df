"""YAML files become checked models; every fault is one line ``file:line: dotted.path: what is wrong``."""

import math
import pickle
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import (
    Acceleration,
    Angle,
    AngularRate,
    Duration,
    Force,
    Frequency,
    Length,
    Mass,
    Power,
    Schema,
    Speed,
    Torque,
    load_yaml,
    parse_tree,
    parse_yaml,
    validate,
    where,
)
from tests.timing import reference_seconds


def test_a_caller_may_change_the_data_of_a_text_that_is_parsed_again() -> None:
    text = "a: {b: [1, 2]}\n"
    data, _ = parse_tree(text, "first")
    data["a"]["b"].append(3)
    again, source = parse_tree(text, "second")
    assert again == {"a": {"b": [1, 2]}}
    assert source.where("a", "b") == "second:1: a.b"


class Plant(Schema):
    time_step: float = 0.005
    contact: Literal["point", "hydroelastic"] = "hydroelastic"


class Pid(Schema):
    kind: Literal["pid"]
    kp: float
    limits: Plant = Plant()


class Off(Schema):
    kind: Literal["off"]


Control = Annotated[Pid | Off, Field(discriminator="kind")]


class Drive(Schema):
    """A format with a field of every type."""

    plant: Plant = Plant()
    control: dict[str, Control] = Field(default={})
    duration: Duration = 10.0
    speed: Speed = 5.0
    start: Angle = 0.0
    laps: int = 1
    record: bool = True
    connect: list[tuple[str, str]] = Field(default=[])
    gains: dict[str, float] = Field(default={})
    points: list[float] = Field(default=[])
    extra: dict[str, Any] = Field(default={})
    parts: list[Plant] = Field(default=[])


def fault(text: str, *overrides: str) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_yaml(text, Drive, name="drive.yaml", overrides=overrides)
    return str(caught.value)


def drive(text: str, *overrides: str) -> dict[str, Any]:
    return parse_yaml(text, Drive, name="drive.yaml", overrides=overrides).model_dump(exclude_unset=True)


PLANT = "(allowed: contact, time_step)"
TOP = "connect, control, duration, extra, gains, laps, parts, plant, points, record, speed, start"

# --- faults of the data, with the exact message ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        # names
        ("plant:\n  time_stepp: 0.001", f"2: plant.time_stepp: unknown field; did you mean 'time_step'? {PLANT}"),
        ("xyz: 1", f"1: xyz: unknown field; allowed: {TOP}"),
        ("parts:\n- {}\n- contcat: point", f"3: parts.1.contcat: unknown field; did you mean 'contact'? {PLANT}"),
        ("plant:\n  time_step: 1\nspeed: 2\nplant: {}", "4: plant: repeated key; keep one of them"),
        ("plant:\n  time_step: 1\n  'time_step': 2", "3: plant.time_step: repeated key; keep one of them"),
        ("1: 2", f"1: 1: unknown field; allowed: {TOP}"),
        ("on: 2", f"1: on: unknown field; allowed: {TOP}"),
        ("gains:\n  [a, b]: 1", "2: gains: a key must be a plain scalar"),
        ("{{a: b}: 1}", "1: a key must be a plain scalar"),
        # numbers
        ("plant:\n  time_step: on", "2: plant.time_step: 'on' is not a number"),
        ("plant:\n  time_step: yes", "2: plant.time_step: 'yes' is not a number"),
        ("plant:\n  time_step: true", "2: plant.time_step: true is not a number"),
        ("points:\n- 1\n- false", "3: points.1: false is not a number"),
        ("control:\n  ego: {kind: pid, kp: true}", "2: control.ego.kp: true is not a number"),
        ("duration: true", "1: duration: must be a number in s, not true"),
        ("laps: true", "1: laps: true is not a number"),
        ("plant:\n  time_step: 5:30", "2: plant.time_step: '5:30' is not a number"),
        ("plant:\n  time_step: .nan", "2: plant.time_step: nan is not a finite number"),
        ("plant:\n  time_step: -.inf", "2: plant.time_step: -inf is not a finite number"),
        ("plant:\n  time_step: 1e999", "2: plant.time_step: inf is not a finite number"),
        ("duration: 1e999 s", "1: duration: inf is not a finite number"),
        ("plant:\n  time_step: 2026-01-02", "2: plant.time_step: '2026-01-02' is not a number"),
        ("laps: 1.5", "1: laps: 1.5 is not a whole number"),
        ("laps: 0x10", "1: laps: '0x10' is not a whole number"),
        (f"laps: {'9' * 5000}", "1: not a number, or too long"),
        ("gains: {a: b}", "1: gains.a: 'b' is not a number"),
        # units
        ("speed: 5 m", "1: speed: unit 'm' does not fit; allowed: m/s, km/h, mph"),
        ("duration: 5 knots", "1: duration: unit 'knots' does not fit; allowed: s, ms, min, h"),
        ("start: north", "1: start: 'north' is not a number"),
        ("speed: [5, m/s]", "1: speed: a list is not a number"),
        # choices and kinds
        ("plant:\n  contact: pint", "2: plant.contact: 'pint' is not allowed; allowed: 'point' or 'hydroelastic'"),
        (
            "control:\n  ego:\n    kp: 1\n    kind: pdi",
            "4: control.ego.kind: unknown kind 'pdi'; did you mean 'pid'? (allowed: off, pid)",
        ),
        ("control:\n  ego: {kind: 5}", "2: control.ego.kind: unknown kind '5'; allowed: off, pid"),
        ("control:\n  ego: {kp: 1}", "2: control.ego: needs a 'kind'; allowed: off, pid"),
        ("control:\n  ego: pid", "2: control.ego: 'pid' is not a mapping (key: value)"),
        (
            "control:\n  ego:\n    kind: pid\n    kp: 2\n    kpp: 3",
            "5: control.ego.kpp: unknown field; did you mean 'kp'? (allowed: kind, kp, limits)",
        ),
        (
            "control:\n  ego:\n    kind: pid\n    kp: 2\n    limits: {contcat: point}",
            f"5: control.ego.limits.contcat: unknown field; did you mean 'contact'? {PLANT}",
        ),
        ("control:\n  ego:\n    kind: pid", "2: control.ego.kp: is missing"),
        # shapes
        ("plant: null", "1: plant: null is not a mapping (key: value)"),
        ("speed: 1\nplant:", "2: plant: null is not a mapping (key: value)"),
        ("[1, 2]", "1: a list is not a mapping (key: value)"),
        ("\n\nhello", "3: 'hello' is not a mapping (key: value)"),
        ("points: 1", "1: points: 1 is not a list"),
        ("points: {a: 1}", "1: points: a mapping is not a list"),
        ("connect:\n- [a]", "2: connect.0.1: is missing"),
        ("connect:\n- [a, b, c]", "2: connect.0: has 3 items; at most 2"),
        ("connect:\n- [a, 1]", "2: connect.0.1: 1 is not a text"),
        ("record: maybe", "1: record: 'maybe' is not allowed; it should be a valid boolean, unable to interpret input"),
    ],
)
def test_a_fault_of_the_data_is_reported_in_one_line(text: str, message: str) -> None:
    assert fault(text) == f"drive.yaml:{message}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("plant:\n\ttime_step: 1", "2: not valid YAML: this line is indented with a tab; use spaces"),
        ("speed: 1\n  laps: 2", "2: not valid YAML: mapping values are not allowed here"),
        ("speed: [1, 2", "1: not valid YAML: expected ',' or ']', but got '<stream end>'"),
        ("speed: *fast", "1: not valid YAML: found undefined alias 'fast'"),
        ("speed: &a 1\nlaps: &a 2", "2: not valid YAML: duplicate anchor 'a'; give each anchor its own name"),
        ("speed: 1\n---\nlaps: 2", "2: not valid YAML: more than one document; remove the line '---'"),
        ("speed: 1\nlaps: \0", "2: not valid YAML: character 0x0 is not allowed"),
        ("speed: \ud800", "1: not valid YAML: character 0xd800 is not allowed"),
        ('speed: "\\UFFFFFFFF"', "1: not valid YAML: a code or version out of range"),
        ("extra: !!python/name:os.abort ''", "1: not valid YAML: unknown tag 'tag:yaml.org,2002:python/name:os.abort'"),
        ("extra: !!binary aGk=", "1: not valid YAML: unknown tag 'tag:yaml.org,2002:binary'"),
        ("extra: !!timestamp no", "1: not valid YAML: unknown tag 'tag:yaml.org,2002:timestamp'"),
        ("extra: !!map [a]", "1: a mapping is expected"),
        ("laps: !!int x", "1: not a number, or too long"),
        ("extra:\n  a: &loop\n    b: *loop", "2: extra.a.b: an alias is inside its own anchor"),
        ("extra: &loop {<<: *loop}", "1: extra: an alias is inside its own anchor"),
        ("speed: 1\nextra: " + "[" * 5000, "2: nested deeper than 60 levels"),
        ("extra: " + "{a: " * 100 + "1" + "}" * 100, "1: nested deeper than 60 levels"),
    ],
)
def test_a_fault_of_the_yaml_is_reported_in_one_line(text: str, message: str) -> None:
    assert fault(text) == f"drive.yaml:{message}"


def test_all_faults_of_a_file_are_reported_together() -> None:
    assert fault("speed: x\nplant:\n  time_step: y\n  contact: z").splitlines() == [
        "drive.yaml:3: plant.time_step: 'y' is not a number",
        "drive.yaml:4: plant.contact: 'z' is not allowed; allowed: 'point' or 'hydroelastic'",
        "drive.yaml:1: speed: 'x' is not a number",
    ]


def test_a_message_stays_one_printable_line_of_sensible_length() -> None:
    message = fault(f'"odd\\nkey\\u0007": {"x" * 1000}\nspeed: {"y" * 1000}')
    assert all(line.isprintable() and len(line) < 250 for line in message.splitlines())


# --- what is understood -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["", "   \n", "# only a comment", "{}", "null", "~", "---\n"])
def test_an_empty_file_means_all_defaults(text: str) -> None:
    assert parse_yaml(text, Drive) == Drive()


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("1E3", 1000.0),
        ("+.5", 0.5),
        ("5.", 5.0),
        ("010", 10.0),
        ("-0", 0.0),
        ("'1.5'", 1.5),
        ("2", 2.0),
    ],
)
def test_numbers_are_read_as_in_yaml_1_2(text: str, value: float) -> None:
    assert drive(f"plant: {{time_step: {text}}}") == {"plant": {"time_step": value}}


@pytest.mark.parametrize("word", ["on", "off", "yes", "no", "y", "5:30", "0x1F", "1_000", "2026-01-02", "=", "0o7"])
def test_words_of_yaml_1_1_are_plain_text(word: str) -> None:
    assert drive(f"extra: {{a: {word}, {word}: b}}") == {"extra": {"a": word, word: "b"}}


def test_keys_are_always_text() -> None:
    assert drive("extra: {1: a, true: b, null: c, 1e3: d}") == {
        "extra": {"1": "a", "true": "b", "null": "c", "1e3": "d"}
    }


def test_truth_values_stay_truth_values_where_they_belong() -> None:
    assert drive("record: false\nextra: {a: true, b: [false]}") == {"record": False, "extra": {"a": True, "b": [False]}}


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        (Angle, "90 deg", math.pi / 2),
        (Angle, "-180°", -math.pi),
        (Angle, "1.5 rad", 1.5),
        (Length, "25.4 mm", 0.0254),
        (Length, "1 in", 0.0254),
        (Speed, "36 km/h", 10.0),
        (Speed, "8m/s", 8.0),
        (Duration, "20 ms", 0.02),
        (Duration, "1.5 min", 90.0),
        (AngularRate, "60 rpm", 2 * math.pi),
        (AngularRate, "180 deg/s", math.pi),
        (Mass, "2 t", 2000.0),
        (Force, "1e1 kN", 1e4),
        (Torque, "2 N m", 2.0),
        (Torque, "2 Nm", 2.0),
        (Power, "1.2 kW", 1200.0),
        (Frequency, "1 kHz", 1000.0),
        (Acceleration, "2 g", 19.6133),
        (Speed, "7", 7.0),
    ],
)
def test_a_number_with_a_unit_becomes_si(kind: Any, text: str, value: float) -> None:
    format_ = type("Format", (Schema,), {"__annotations__": {"x": kind}})
    for written in (text, f"'  {text} '"):
        assert parse_yaml(f"x: {written}", format_).model_dump()["x"] == pytest.approx(value, rel=1e-15)


def test_anchors_aliases_and_merges_are_written_out() -> None:
    text = "parts:\n- &slow {time_step: 0.01, contact: point}\n- {<<: *slow, time_step: 0.02}\n- *slow\n"
    assert drive(text)["parts"] == [
        {"time_step": 0.01, "contact": "point"},
        {"time_step": 0.02, "contact": "point"},
        {"time_step": 0.01, "contact": "point"},
    ]


def test_a_fault_in_a_merged_key_points_to_the_place_where_it_is_written() -> None:
    text = "extra:\n  base: &base\n    contcat: point\nplant:\n  <<: *base\n  time_step: 0.01"
    assert fault(text).startswith("drive.yaml:3: plant.contcat: unknown field; did you mean 'contact'?")


def test_a_model_used_twice_by_alias_is_two_models() -> None:
    spec = parse_yaml("parts: [&a {time_step: 1}, *a]", Drive)
    spec.parts[0].time_step = 2.0
    assert spec.parts[1].time_step == 1.0


def test_defaults_are_not_shared() -> None:
    first, second = parse_yaml("", Drive), parse_yaml("", Drive)
    first.points.append(1.0)
    first.plant.time_step = 7.0
    assert (second.points, second.plant.time_step) == ([], 0.005)


# --- hostile files ------------------------------------------------------------------------------------------------


def _laughs(levels: int, merge: bool) -> str:
    lines = ["extra:", "  a0: &a0 {x: 1}"]
    for level in range(1, levels):
        aliases = ", ".join([f"*a{level - 1}"] * 10)
        lines.append(f"  a{level}: &a{level} " + (f"{{<<: [{aliases}]}}" if merge else f"[{aliases}]"))
    return "\n".join(lines)


@pytest.mark.parametrize("merge", [False, True])
def test_a_small_file_that_means_billions_of_values_is_rejected_at_once(merge: bool) -> None:
    text = _laughs(12, merge)
    assert "more than 200000 values (with aliases expanded)" in fault(text)
    assert reference_seconds(lambda: fault(text), times=1) < 5.0


def test_a_large_valid_file_is_read() -> None:
    points = parse_yaml(f"points: [{', '.join(['1.5'] * 20_000)}]", Drive).points
    assert len(points) == 20_000


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(b"speed: \xff\xfe")
    (tmp_path / "folder.yaml").mkdir()
    (tmp_path / "loop.yaml").symlink_to("loop.yaml")
    (tmp_path / "marked.yaml").write_text("speed: 3", encoding="utf-8-sig")
    for name, message in {
        "absent.yaml": "absent.yaml: no such file",
        "binary.yaml": "binary.yaml: not UTF-8 text (byte 7)",
        "folder.yaml": "folder.yaml: is a folder; a YAML file is expected",
        "zero\0.yaml": r"zero\x00.yaml: cannot be read: embedded null byte",
    }.items():
        with pytest.raises(ConfigError) as caught:
            load_yaml(tmp_path / name, Drive)
        assert str(caught.value).removeprefix(f"{tmp_path}/") == message
    with pytest.raises(ConfigError, match="cannot be read"):
        load_yaml(tmp_path / "loop.yaml", Drive)
    assert load_yaml(tmp_path / "marked.yaml", Drive).speed == 3.0


def test_a_file_below_the_working_directory_is_named_relative_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "deep" / "drive.yaml"
    file.parent.mkdir()
    file.write_text("speed: x")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"^deep/drive\.yaml:1: speed: 'x' is not a number$"):
        load_yaml(file, Drive)


# --- where --------------------------------------------------------------------------------------------------------

NESTED = """\
plant:
  contact: point
control:
  ego:
    kind: pid
    kp: 1
    limits:
      contact: point
parts:
- time_step: 1
-
  time_step: 2
"""


def test_a_nested_spec_still_points_into_the_file() -> None:
    spec = parse_yaml(NESTED, Drive, name="drive.yaml")
    pid = spec.control["ego"]
    assert isinstance(pid, Pid)
    assert where(spec) == "drive.yaml:1"
    assert where(spec, "plant", "contact") == "drive.yaml:2: plant.contact"
    assert where(spec.plant) == "drive.yaml:1: plant"
    assert where(spec.plant, "time_step") == "drive.yaml:1: plant.time_step"  # a default: its parent's line
    assert where(pid, "kp") == "drive.yaml:6: control.ego.kp"
    assert where(pid.limits, "contact") == "drive.yaml:8: control.ego.limits.contact"
    assert where(spec.parts[1], "time_step") == "drive.yaml:12: parts.1.time_step"
    assert where(spec, "parts", 1, "time_step") == "drive.yaml:12: parts.1.time_step"
    assert where(spec, "speed") == "drive.yaml:1: speed"


def test_a_part_of_a_file_can_be_checked_later_and_still_points_into_it() -> None:
    spec = parse_yaml(
        "speed: 1\nextra:\n  block:\n    contact: point\n    deeper: {kp: 1, time_step: x}", Drive, name="d"
    )
    assert spec._source is not None
    part = spec._source._replace(prefix=("extra", "block"))
    assert where(validate({"contact": "point"}, Plant, part), "contact") == "d:4: extra.block.contact"
    with pytest.raises(ConfigError, match=r"^d:5: extra\.block\.deeper: unknown field; allowed: contact, time_step$"):
        validate(spec.extra["block"], Plant, part)
    inner = spec._source._replace(prefix=("extra", "block", "deeper"))
    with pytest.raises(ConfigError) as caught:
        validate({"kp": 1, "time_step": "x"}, Plant, inner)
    assert str(caught.value).splitlines() == [
        "d:5: extra.block.deeper.time_step: 'x' is not a number",
        "d:5: extra.block.deeper.kp: unknown field; allowed: contact, time_step",
    ]


class Frozen(Schema, frozen=True):
    gain: float = 1.0


class Holder(Schema, frozen=True):
    inner: Frozen = Frozen()


def test_the_default_of_one_file_does_not_point_into_another() -> None:
    first, second = parse_yaml("", Holder, name="one"), parse_yaml("", Holder, name="two")
    assert where(first.inner) == "one: inner"
    assert where(second.inner) == "two: inner"
    assert where(Holder().inner) == "Frozen"
    assert first == second
    assert hash(first) == hash(second)


def test_a_spec_made_in_python_names_its_class() -> None:
    assert where(Drive(), "plant", "contact") == "Drive: plant.contact"
    assert where(Plant()) == "Plant"


def test_an_override_is_named_instead_of_the_line_it_replaces() -> None:
    spec = parse_yaml(NESTED, Drive, name="drive.yaml", overrides=["control.ego.kp=3", "plant={contact: point}"])
    assert where(spec.control["ego"], "kp") == "--set control.ego.kp=3: control.ego.kp"
    assert where(spec.control["ego"], "kind") == "drive.yaml:5: control.ego.kind"
    assert where(spec.plant, "contact") == "--set plant={contact: point}: plant.contact"
    assert where(spec.plant, "time_step") == "--set plant={contact: point}: plant.time_step"


def test_the_source_is_not_part_of_the_value() -> None:
    first, second = parse_yaml("speed: 5", Drive, name="a"), parse_yaml("\n\nspeed: 5", Drive, name="b")
    assert first == second
    assert first != parse_yaml("speed: 6", Drive, name="a")
    assert first.plant == Plant()
    assert first.model_dump() == second.model_dump()


def test_a_spec_keeps_its_source_through_a_copy_and_into_a_worker() -> None:
    spec = parse_yaml(NESTED, Drive, name="drive.yaml")
    for copy in (spec.model_copy(deep=True), pickle.loads(pickle.dumps(spec))):
        assert copy == spec
        assert where(copy.parts[1], "time_step") == "drive.yaml:12: parts.1.time_step"


# --- overrides ----------------------------------------------------------------------------------------------------


def test_the_command_line_wins_over_the_file_and_the_file_over_the_defaults() -> None:
    assert parse_yaml("", Drive).speed == 5.0
    assert parse_yaml("speed: 6", Drive).speed == 6.0
    assert parse_yaml("speed: 6", Drive, overrides=["speed=7"]).speed == 7.0
    assert parse_yaml("speed: 6", Drive, overrides=["speed=7", "speed=8"]).speed == 8.0


@pytest.mark.parametrize(
    ("override", "key", "value"),
    [
        ("plant.contact=hydroelastic", "plant", {"contact": "hydroelastic"}),
        ("plant.time_step=1e-3", "plant", {"contact": "point", "time_step": 0.001}),
        (" plant . time_step = 2 ", "plant", {"contact": "point", "time_step": 2.0}),
        ("speed=36 km/h", "speed", 10.0),
        ("points=[1, 2]", "points", [1.0, 2.0]),
        ("parts.1.contact=point", "parts", [{"time_step": 1.0}, {"time_step": 2.0, "contact": "point"}]),
        ("parts.0={contact: point}", "parts", [{"contact": "point"}, {"time_step": 2.0}]),
        ("gains.a=1", "gains", {"a": 1.0}),
        ("extra.a.b.c=x=y", "extra", {"a": {"b": {"c": "x=y"}}}),
        ("extra.a=", "extra", {"a": None}),
        ("extra.a={}", "extra", {"a": {}}),
        ("extra={1: {2: z}}", "extra", {"1": {"2": "z"}}),
        ("control.ego={kind: off}", "control", {"ego": {"kind": "off"}}),
    ],
)
def test_an_override_sets_one_place(override: str, key: str, value: Any) -> None:
    changed, plain = drive(NESTED, override), drive(NESTED)
    assert changed.pop(key) == value
    plain.pop(key, None)
    assert changed == plain


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("speed", ": expected KEY.PATH=VALUE, for example control.ego.speed=8"),
        ("=5", ": expected KEY.PATH=VALUE, for example control.ego.speed=8"),
        ("plant..contact=5", ": expected KEY.PATH=VALUE, for example control.ego.speed=8"),
        ("speed=[", ":1: not valid YAML: expected the node content, but found '<stream end>'"),
        ("sped=5", f": sped: unknown field; did you mean 'speed'? (allowed: {TOP})"),
        ("plant.contcat=x", ": plant.contcat: unknown field; did you mean 'contact'? (allowed: contact, time_step)"),
        ("plant.contact=pint", ": plant.contact: 'pint' is not allowed; allowed: 'point' or 'hydroelastic'"),
        ("plant.contact.deeper=1", ": plant.contact: a mapping is not allowed; allowed: 'point' or 'hydroelastic'"),
        ("plant=", ": plant: null is not a mapping (key: value)"),
        ("control.ego={kind: pdi}", ": control.ego.kind: unknown kind 'pdi'; did you mean 'pid'? (allowed: off, pid)"),
        ("control.other.kp=1", ": control.other: needs a 'kind'; allowed: off, pid"),
        ("parts.2.contact=point", ": parts is a list of 2; '2' is not an index of it"),
        (f"parts.{'9' * 20}=", ": parts is a list of 2; '99999999999999999999' is not an index of it"),
        ("parts.-1.contact=point", ": parts is a list of 2; '-1' is not an index of it"),
        ("parts.time_step=1", ": parts is a list of 2; 'time_step' is not an index of it"),
        ("parts.1.time_step=x", ": parts.1.time_step: 'x' is not a number"),
        ("speed=5 kg", ": speed: unit 'kg' does not fit; allowed: m/s, km/h, mph"),
    ],
)
def test_a_wrong_override_names_itself(override: str, message: str) -> None:
    assert fault(NESTED, override) == f"--set {override}{message}"


def test_an_override_changes_one_alias_and_not_the_others() -> None:
    text = "parts: [&a {time_step: 1}, *a]"
    assert drive(text, "parts.0.time_step=2")["parts"] == [{"time_step": 2.0}, {"time_step": 1.0}]


def test_an_override_does_not_hide_that_the_file_is_not_a_mapping() -> None:
    assert fault("[1]", "speed=3") == "drive.yaml:1: a list is not a mapping (key: value)"


# --- any text at all ----------------------------------------------------------------------------------------------

PIECES = [
    *(
        "{",
        "}",
        "[",
        "]",
        ":",
        "- ",
        ", ",
        "? ",
        "\n",
        "  ",
        "\t",
        "#",
        "\\",
        "'",
        '"',
        "|\n",
        ">-\n",
        "@",
        "`",
        "&a ",
        "*a",
    ),
    *(
        "<<: ",
        "!!int ",
        "!x ",
        "%YAML 1.1\n",
        "---\n",
        "...",
        "null",
        "true",
        ".nan",
        "1e9",
        "kind: pid",
        "\ufeff",
        "\x85",
    ),
]


def _refusal(text: str, *overrides: str) -> list[str]:
    """Return the lines of the ConfigError, none when the text is accepted; any other error fails the test."""
    try:
        parse_yaml(text, Drive, name="drive.yaml", overrides=overrides)
    except ConfigError as error:
        return str(error).split("\n")
    return []


def _never_fails_otherwise(text: str) -> None:
    lines = _refusal(text)
    assert all(line.startswith("drive.yaml:") and line.isprintable() for line in lines)


@settings(max_examples=200)
@given(st.one_of(st.text(), st.lists(st.one_of(st.sampled_from(PIECES), st.text(max_size=3))).map("".join)))
def test_any_text_is_read_or_rejected_with_a_line(text: str) -> None:
    _never_fails_otherwise(text)


@settings(max_examples=200)
@given(st.data())
def test_a_damaged_file_is_read_or_rejected_with_a_line(data: st.DataObject) -> None:
    text = NESTED
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(text)))
        stop = data.draw(st.integers(start, min(start + 8, len(text))))
        text = text[:start] + data.draw(st.one_of(st.sampled_from(PIECES), st.text(max_size=4))) + text[stop:]
    _never_fails_otherwise(text)


@settings(max_examples=100)
@given(st.text(), st.text())
def test_any_override_is_accepted_or_rejected_with_its_text(key: str, value: str) -> None:
    lines = _refusal(NESTED, f"{key}={value}")
    assert all(line.startswith(("--set ", "drive.yaml:")) for line in lines)


@settings(max_examples=100)
@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
        max_leaves=12,
    )
)
def test_plain_data_written_as_yaml_comes_back(value: Any) -> None:
    data, _ = parse_tree(yaml.safe_dump({"value": value}), "x")
    assert data == {"value": value}


# --- faults for programs ---


@pytest.mark.parametrize(
    ("text", "line", "path", "code"),
    [
        ("plant:\n  time_stp: 1\n", 2, ("plant", "time_stp"), "unknown_key"),
        ("control:\n  ego: {kind: pid}\n", 2, ("control", "ego", "kp"), "missing_key"),
        ("control:\n  ego: {kind: pdi}\n", 2, ("control", "ego", "kind"), "unknown_kind"),
        ("plant: 3\n", 1, ("plant",), "wrong_type"),
        ("plant:\n  time_step: fast\n", 2, ("plant", "time_step"), "not_a_number"),
        ("plant:\n  time_step: true\n", 2, ("plant", "time_step"), "not_a_number"),
        ("plant:\n  time_step: .inf\n", 2, ("plant", "time_step"), "not_finite"),
        ("plant:\n  contact: soft\n", 2, ("plant", "contact"), "not_allowed"),
        ("duration: 3 kg\n", 1, ("duration",), "bad_value"),
        ("a: [\n", 2, (), "not_yaml"),
    ],
)
def test_a_fault_carries_file_line_path_and_code(text: str, line: int, path: tuple[str, ...], code: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_yaml(text, Drive, name="drive.yaml")
    (fault,) = caught.value.faults
    assert (fault.file, fault.line, fault.path, fault.code) == ("drive.yaml", line, path, code)
    assert str(fault).startswith(f"drive.yaml:{line}: ")


def test_a_fault_of_an_override_names_the_override() -> None:
    with pytest.raises(ConfigError) as caught:
        parse_yaml("", Drive, overrides=["plant.contact=soft", "plant.time_step=fast"])
    first, second = sorted(caught.value.faults, key=lambda fault: str(fault.path))
    assert (first.file, first.line, first.path) == ("--set plant.contact=soft", None, ("plant", "contact"))
    assert second.code == "not_a_number"
