"""Fitted parameters into vehicle.yaml: written values, omitted values and the reasons."""

import argparse
import shutil
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from mirdrake.cli import identify_apply
from mirdrake.core.errors import ConfigError
from mirdrake.identification.apply import YAML_ENTRIES, plan_apply, read_fit
from mirdrake.identification.fit import Fit, FittedParameter
from mirdrake.tyres.brush import BrushTyres
from mirdrake.vehicles import load_vehicle
from mirdrake.vehicles.spec import VehicleSpec

ROOT = Path(__file__).resolve().parent.parent
DAY = date(2026, 3, 1)


def _fit(*parameters: FittedParameter) -> Fit:
    free = sum(parameter.kind != "fixed" for parameter in parameters)
    return Fit("coast", "longitudinal", "least squares", parameters, np.eye(free), 10.0, data_sha256="ab12" * 16)


def _found(name: str, unit: str, value: float, **more: object) -> FittedParameter:
    return FittedParameter(name, unit, value, 0.01 * value, 0.98 * value, 1.02 * value, **more)  # type: ignore[arg-type]


DRAG = _found("drag_area", "m^2", 0.6414)


@pytest.fixture
def bolt(tmp_path: Path) -> Path:
    return Path(shutil.copytree(ROOT / "models" / "bolt", tmp_path / "bolt"))


def test_a_value_and_its_source_are_written_and_nothing_else(bolt: Path) -> None:
    before = (bolt / "vehicle.yaml").read_text()
    (change,) = plan_apply(_fit(DRAG), str(bolt), today=DAY).files
    source = "identified 2026-03-01: fit coast, 95 % interval 0.6286 to 0.6542, data sha256 ab12ab12ab12ab12"
    expected = before.replace("drag_area: 0.798  #", "drag_area: 0.6414  #").replace(
        '"EPA road load of the 2022 Bolt EV, 2 C / rho = 2 x 0.4788 / 1.2 m²"', f'"{source}"'
    )
    assert change.after == expected
    change.write()
    spec = load_vehicle(str(bolt)).spec
    assert spec.aerodynamics.drag_area == 0.6414
    assert spec.sources["aerodynamics.drag_area"] == source
    assert spec.numbers_without_source() == []


def test_a_second_time_nothing_happens_on_whatever_day(bolt: Path) -> None:
    plan_apply(_fit(DRAG), str(bolt), today=DAY).files[0].write()
    assert not plan_apply(_fit(DRAG), str(bolt), today=date(2027, 1, 1)).changes


def test_an_axle_stiffness_is_split_over_two_tyres_and_written_as_the_variant_states(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(ROOT / "models" / "mkz", tmp_path / "mkz"))
    base = (folder / "vehicle.yaml").read_bytes()
    fit = _fit(_found("cornering_stiffness_front", "N/rad", 120000.0), _found("steering_ratio", "1", 15.5))
    change = plan_apply(fit, f"{folder}@handling", today=DAY)
    assert [file.path.name for file in change.files] == ["handling.yaml", "vehicle.yaml"]
    change.files[0].write()
    assert (folder / "vehicle.yaml").read_bytes() == base
    change.files[1].write()
    spec = load_vehicle(f"{folder}@handling").spec
    assert isinstance(spec.tyres, BrushTyres)
    assert spec.tyres.front.cornering_stiffness == 60000.0
    assert spec.steering.ratio == 15.5
    assert spec.sources_without_number() == []
    assert spec.numbers_without_source() == []


@pytest.mark.parametrize(
    ("parameter", "reason"),
    [
        (
            _found("drag_area", "m^2", 0.6, verdict="not identifiable", explanation="one speed"),
            "not identifiable from these",
        ),
        (_found("drag_area", "m^2", 0.6, at_bound="high"), "the estimate is at its upper bound"),
        (_found("drag_area", "m^2", 0.6, at_bound="low"), "the estimate is at its lower bound"),
        (FittedParameter("drag_area", "m^2", 0.6, kind="fixed"), "it was fixed"),
        (
            _found("drag_area", "kg/m", 0.6),
            "its unit is kg/m, that of aerodynamics.drag_area is m^2; fit with a known mass",
        ),
        (_found("yaw_inertia", "kg m^2", 2500.0), "follows from the bodies of the URDF"),
        (_found("roll_gain", "rad s^2/m", 0.01), "vehicle.yaml has no entry for it"),
        (_found("cornering_stiffness_rear", "N/rad", 1e5), "the tyres are of kind coulomb; only brush has"),
        (_found("steering_delay", "s", -0.02), "-0.02 is not possible there"),
    ],
)
def test_skipped_parameters_have_a_reason(bolt: Path, parameter: FittedParameter, reason: str) -> None:
    change = plan_apply(_fit(parameter), str(bolt), today=DAY)
    assert change.files == ()
    (line,) = change.skipped
    assert line.startswith(f"{parameter.name}: not written: ")
    assert reason in line


def test_a_delay_is_rounded_to_whole_controller_periods_with_a_note(bolt: Path) -> None:
    change = plan_apply(_fit(_found("steering_delay", "s", 0.087)), str(bolt), today=DAY)
    assert change.notes == ("steering_delay: 0.087 s is rounded to 0.08 s, whole periods of 0.02 s",)
    change.files[0].write()
    assert load_vehicle(str(bolt)).spec.actuators.steering.delay == 0.08


def test_a_value_that_contradicts_the_given_one_is_written_with_a_note(bolt: Path) -> None:
    contradicting = _found(
        "steering_ratio", "1", 14.2, given=16.8, verdict="contradicts the given value", explanation="given 16.8"
    )
    change = plan_apply(_fit(contradicting), str(bolt), today=DAY)
    assert change.notes == ("steering_ratio: contradicts the given value (given 16.8)",)
    assert "ratio: 14.2\n" in change.files[0].after


WEAK = _found("drag_area", "m^2", 0.6414, verdict="weakly identified", explanation="the model lacks an effect")


def test_a_weakly_identified_value_is_written_with_force_only(bolt: Path) -> None:
    change = plan_apply(_fit(WEAK), str(bolt), today=DAY)
    assert change.files == ()
    assert change.skipped == (
        "drag_area: not written: only weakly identified: 0.6414 m^2, 95 % interval 0.6286 to 0.6542 "
        "(the model lacks an effect); --force writes it",
    )
    forced = plan_apply(_fit(WEAK), str(bolt), today=DAY, force=True)
    assert forced.notes == ("drag_area: weakly identified (the model lacks an effect)",)
    assert "drag_area: 0.6414  #" in forced.files[0].after
    assert ", weakly identified, data sha256" in forced.files[0].after


def test_force_does_not_write_what_is_not_identifiable(bolt: Path) -> None:
    unknown = _found("drag_area", "m^2", 0.6, verdict="not identifiable")
    assert not plan_apply(_fit(unknown), str(bolt), today=DAY, force=True).changes


def test_the_command_writes_a_weakly_identified_value_with_force_only(
    bolt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, before = _fit(WEAK).save(tmp_path / "fit"), (bolt / "vehicle.yaml").read_bytes()
    parser = argparse.ArgumentParser()
    identify_apply.add_arguments(parser)
    assert identify_apply.run(parser.parse_args([str(folder), str(bolt)])) == 0
    shown = capsys.readouterr().out
    assert "--force writes it\nnothing to write\n" in shown
    assert (bolt / "vehicle.yaml").read_bytes() == before
    assert identify_apply.run(parser.parse_args([str(folder), str(bolt), "--force"])) == 0
    assert "vehicle.yaml: written" in capsys.readouterr().out
    assert load_vehicle(str(bolt)).spec.aerodynamics.drag_area == 0.6414


def test_every_place_of_the_table_is_a_field_of_vehicle_yaml() -> None:
    schema = VehicleSpec.model_json_schema()
    text = str(schema)
    paths = [entry.path for entry in YAML_ENTRIES.values()] + [entry.path for entry in BrushTyres.fitted.values()]
    for path in paths:
        assert f"'{path.rpartition('.')[2]}'" in text, path


def test_the_command_shows_writes_and_has_nothing_to_do_the_second_time(
    bolt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = _fit(DRAG, _found("mass", "kg", 1700.0)).save(tmp_path / "fit")
    parser = argparse.ArgumentParser()
    identify_apply.add_arguments(parser)
    before = (bolt / "vehicle.yaml").read_bytes()
    assert identify_apply.run(parser.parse_args([str(folder), "--vehicle", str(bolt), "--dry-run"])) == 0
    shown = capsys.readouterr().out
    assert "+  drag_area: 0.6414  # m²\n" in shown
    assert "mass: not written: follows from the bodies of the URDF" in shown
    assert (bolt / "vehicle.yaml").read_bytes() == before
    assert identify_apply.run(parser.parse_args([str(folder), str(bolt)])) == 0
    assert "vehicle.yaml: written" in capsys.readouterr().out
    assert identify_apply.run(parser.parse_args([str(folder), str(bolt)])) == 0
    assert "nothing to write" in capsys.readouterr().out


def test_without_a_fit_or_a_vehicle_the_error_names_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such folder; give the folder that mirdrake identify has written"):
        read_fit(tmp_path / "nowhere")
    folder = _fit(DRAG).save(tmp_path / "fit")
    parser = argparse.ArgumentParser()
    identify_apply.add_arguments(parser)
    with pytest.raises(ConfigError, match=r"the vehicle is missing: mirdrake identify apply .* --vehicle bolt"):
        identify_apply.run(parser.parse_args([str(folder)]))
