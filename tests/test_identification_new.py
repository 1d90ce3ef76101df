"""A data file is proposed for logs in other people's formats; loaded, it gives the true channels."""

import json
import math
from shutil import rmtree

import numpy as np
import pytest
from mcap.writer import Writer

import mirdrake as mir
from mirdrake.cli import main
from mirdrake.core.vectors import STATE
from mirdrake.core.yaml_io import load_yaml
from mirdrake.identification import load_data
from mirdrake.identification.channels import CHANNELS, quantity
from mirdrake.identification.column_names import channel_by_name, channels_of_run, unit_by_name
from mirdrake.identification.default_study import default_study
from mirdrake.identification.spec import DataSpec
from mirdrake.single_track import estimate_parameters
from mirdrake.vehicles import load_vehicle
from tests.test_identification_data import changed, checked, clean, recorded

G, KMH, DEG = 9.80665, 3.6, 180.0 / math.pi


def truth():
    """Return time and channels of a noisy drive, with a hand wheel and the position."""
    log = recorded(3)
    t, channels = log.time, dict(log.channels)
    _, exact = clean()
    vx, vy, yaw = exact["vx"], exact["vy"], exact["yaw"]
    channels["steering_wheel_angle"] = 15.5 * channels["road_wheel_angle"]
    step = t[1] - t[0]
    channels["x"] = np.cumsum(vx * np.cos(yaw) - vy * np.sin(yaw)) * step
    channels["y"] = np.cumsum(vx * np.sin(yaw) + vy * np.cos(yaw)) * step
    return t, channels


def proposed(folder, name, capsys):
    """Return the log that the proposed data file describes, and its text."""
    assert main(["identify", "new", str(folder / name)]) == 0
    text = capsys.readouterr().out
    data = (folder / name).with_suffix(".yaml")
    assert data.read_text(encoding="utf-8") in text
    (log,) = load_data(data).logs
    return log, text


def agree(log, channels, names, rows=slice(None)):
    """Check that channels of a log are the true ones."""
    for name in names:
        true = channels[name][rows]
        assert log.channels[name] == pytest.approx(true, abs=2e-3 * np.ptp(true)), name


def write_table(path, columns, header, *, delimiter=",", comma=False):
    rows = "\n".join(delimiter.join(f"{value:.7g}" for value in row) for row in np.column_stack(list(columns)))
    path.write_text(header + (rows.replace(".", ",") if comma else rows) + "\n", encoding="utf-8")


def test_a_german_log_with_units_below_a_commented_header(tmp_path, capsys):
    t, c = truth()
    columns = [t, KMH * c["vx"], DEG * c["yaw_rate"], c["lateral_acceleration"] / G, DEG * c["steering_wheel_angle"],
               200.0 + 0.0 * t + np.arange(len(t)) % 7]  # fmt: skip
    header = "# Messfahrt Boxberg\n# Zeit; Geschwindigkeit; Gierrate; Querbeschleunigung; Lenkwinkel; Öltemperatur\n"
    write_table(tmp_path / "fahrt.csv", columns, header + "# s; km/h; °/s; g; °; °C\n", delimiter=";", comma=True)
    log, text = proposed(tmp_path, "fahrt.csv", capsys)
    agree(log, {**c, "speed": c["vx"]}, ("speed", "yaw_rate", "lateral_acceleration", "steering_wheel_angle"))
    assert '#   "Öltemperatur": 200 to 206 °C' in text


def test_units_and_signs_that_nobody_states_follow_from_kinematics(tmp_path, capsys):
    """Gyro in deg/s with z down, acceleration in g, a compass, a road wheel angle in rad, a clock in ms."""
    t, c = truth()
    columns = [1e3 * t, KMH * c["vx"], -DEG * c["yaw_rate"], c["lateral_acceleration"] / G, c["road_wheel_angle"],
               90.0 - DEG * c["yaw"], c["longitudinal_acceleration"]]  # fmt: skip
    write_table(tmp_path / "log.csv", columns, "Timestamp,CarSpeed,GyroZ,AccY,SteerAngle,Heading,AccX\n")
    log, text = proposed(tmp_path, "log.csv", capsys)
    assert log.time == pytest.approx(t)
    names = ("yaw_rate", "lateral_acceleration", "road_wheel_angle", "longitudinal_acceleration")
    agree(log, {**c, "speed": c["vx"]}, ("speed", *names))
    assert np.diff(log.channels["yaw"]) == pytest.approx(np.diff(c["yaw"]), abs=1e-5)
    assert "unit guessed from steps of 10" in text
    assert text.count("sign: -1") == 2


def test_both_wheels_latitude_and_longitude_give_steering_and_position(tmp_path, capsys):
    t, c = truth()
    radius = 6_371_000.0
    latitude, longitude = 50.0 + DEG * c["y"] / radius, 8.0 + DEG * c["x"] / (radius * math.cos(math.radians(50.0)))
    delta = c["road_wheel_angle"]
    columns = {
        "t_s": t, "v_x_mps": c["vx"], "steer_fl_deg": DEG * 1.03 * delta, "steer_fr_deg": DEG * 0.97 * delta,
        "wz_dps": DEG * c["yaw_rate"], "lat_deg": latitude, "lon_deg": longitude, "v_soll_kmh": KMH * (c["vx"] + 0.1),
        "bank_deg": 1.0 + 0.1 * np.sin(t), "Fy_FL_kN": 0.5 * np.sin(t),
    }  # fmt: skip
    np.savez(tmp_path / "run.npz", **columns)
    log, text = proposed(tmp_path, "run.npz", capsys)
    agree(log, c, ("vx", "road_wheel_angle", "yaw_rate"))
    # The Earth is no sphere: by 0.5 %.
    assert log.channels["x"] == pytest.approx(c["x"] - c["x"][0], abs=0.006 * np.ptp(c["x"]))
    assert log.channels["speed_command"] == pytest.approx(c["vx"] + 0.1)
    assert np.ptp(log.channels["tyre_force_y_front_left"]) == pytest.approx(1000.0, rel=0.01)
    assert "bank: {column: bank_deg" in text
    assert "road_wheel_angle from road_wheel_angle_left and road_wheel_angle_right: mean of both" in " ".join(log.notes)


def test_spin_angles_of_wheels_are_not_steering(tmp_path, capsys):
    """A run of mirdrake as CSV: angles of wheels about their axles grow, and change no sign of other channels."""
    t, c = truth()
    radius, half = 0.3, 0.75
    columns = {
        "time [s]": t, "ego.x [m]": c["x"], "ego.y [m]": c["y"], "ego.yaw [rad]": c["yaw"], "ego.vx [m/s]": c["vx"],
        "ego.wz [rad/s]": c["yaw_rate"], "ego.steering_angle.left [rad]": 1.03 * c["road_wheel_angle"],
        "ego.steering_angle.right [rad]": 0.97 * c["road_wheel_angle"],
    }  # fmt: skip
    for side, sign in (("left", -1.0), ("right", 1.0)):
        turned = np.cumsum((c["vx"] + sign * half * c["yaw_rate"]) / radius) * (t[1] - t[0])
        columns |= {f"ego.wheel_angle.{axle}_{side} [rad]": turned for axle in ("front", "rear")}
    write_table(tmp_path / "signals.csv", columns.values(), ",".join(columns) + "\n")
    log, text = proposed(tmp_path, "signals.csv", capsys)
    agree(log, c, ("x", "y", "vx", "yaw_rate", "road_wheel_angle"))
    assert "sign: -1" not in text
    assert "column: ego.wheel_angle" not in text


def test_topics_of_a_bag_are_mapped_by_the_types_of_their_messages(tmp_path, capsys):
    """An IMU, odometry, a command, and a vendor's own type, as JSON in MCAP."""
    t, c = truth()
    with (tmp_path / "drive.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        kinds = {
            "/sensing/imu": "sensor_msgs/msg/Imu", "/odom": "nav_msgs/Odometry", "/camera": "sensor_msgs/msg/Image",
            "/cmd": "ackermann_msgs/msg/AckermannDriveStamped", "/acme/chassis": "acme_msgs/msg/Chassis",
        }  # fmt: skip
        topics = {
            topic: writer.register_channel(topic, "json", writer.register_schema(kind, "jsonschema", b"{}"))
            for topic, kind in kinds.items()
        }

        def vector(x=0.0, y=0.0, z=0.0):
            return {"x": x, "y": y, "z": z}

        for row, now in [*enumerate(t)][::4]:
            side, forward, turn = (float(c[name][row]) for name in ("lateral_acceleration", "vx", "yaw_rate"))
            half = 0.5 * float(c["yaw"][row])
            angle = {"w": math.cos(half), **vector(z=math.sin(half))}
            messages = {
                "/sensing/imu": {"angular_velocity": vector(z=turn), "linear_acceleration": vector(0.0, side, 9.8)},
                "/odom": {"pose": {"pose": {"position": vector(), "orientation": angle}},
                          "twist": {"twist": {"linear": vector(forward), "angular": vector(z=turn)}}},
                "/camera": {"height": 480, "data": [1, 2]},
                "/cmd": {"drive": {"speed": forward + 0.2, "steering_angle": 0.1 * turn}},
                "/acme/chassis": {"steering_wheel_angle_deg": DEG * float(c["steering_wheel_angle"][row])},
            }  # fmt: skip
            for topic, message in messages.items():
                stamp = int(1e9 * now) + 10**18
                writer.add_message(topics[topic], stamp, json.dumps(message).encode(), stamp)
        writer.finish()
    log, text = proposed(tmp_path, "drive.mcap", capsys)
    rows = slice(None, None, 4)
    agree(log, c, ("vx", "yaw_rate", "lateral_acceleration", "steering_wheel_angle"), rows)
    assert log.channels["speed_command"] == pytest.approx(c["vx"][rows] + 0.2)
    assert "field of sensor_msgs/msg/Imu" in text
    assert {"yaw_rate@odom", "yaw_rate@sensing_imu"} & set(log.channels)
    assert "/camera" not in text


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("notes.csv", "name,town\n" + "a,b\n" * 30, "has no column of numbers"),
        ("oil.csv", "time,oil\n" + "".join(f"{row},{row % 7}\n" for row in range(30)), "no column has a known name"),
        ("short.csv", "time,vx\n0,1\n", "has no column of numbers"),
        (
            "long.csv",
            "time,signal,value\n" + "".join(f"{row},speed,1\n{row},yaw_rate,2\n" for row in range(30)),
            "the cells of column 'signal' are names of channels",
        ),
    ],
)
def test_a_log_without_known_columns_is_reported_in_one_line(tmp_path, capsys, name, content, expected):
    (tmp_path / name).write_text(content, encoding="utf-8")
    assert main(["identify", "new", str(tmp_path / name)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert expected in line


def test_a_stated_rate_makes_a_rate_of_the_name_of_an_angle():
    assert channel_by_name("Yaw", "deg/s") == "yaw_rate"
    assert channel_by_name("Yaw", "deg") == "yaw"


def test_a_turned_accelerometer_is_found_by_the_turns(tmp_path, capsys):
    """Its x axis is to the left; with the axes by their names, the check finds the exchange."""
    t, c = truth()
    columns = [t, c["vx"], c["yaw_rate"], c["lateral_acceleration"], c["longitudinal_acceleration"]]
    write_table(tmp_path / "log.csv", columns, "time [s],vx [m/s],yaw_rate [rad/s],acc_x [m/s^2],acc_y [m/s^2]\n")
    log, text = proposed(tmp_path, "log.csv", capsys)
    agree(log, c, ("longitudinal_acceleration", "lateral_acceleration"))
    assert text.count("axis by the relations") == 2
    data = tmp_path / "log.yaml"
    wrong = {"lateral": "x", "longitudinal": "y"}
    lines = [line for line in data.read_text(encoding="utf-8").splitlines() if "_acceleration:" not in line]
    at = next(index for index, line in enumerate(lines) if line.startswith("channels:"))
    lines[at + 1 : at + 1] = [
        f"  {name}_acceleration: {{column: acc_{'y' if axis == 'x' else 'x'}}}" for name, axis in wrong.items()
    ]
    data.write_text("\n".join(lines), encoding="utf-8")
    assert main(["identify", "check", str(data)]) == 1
    assert "their columns are exchanged" in capsys.readouterr().out


def test_truth_values_and_distances_are_neither_a_steering_nor_a_clock(tmp_path, capsys):
    t, c = truth()
    columns = [np.cumsum(c["vx"]) * (t[1] - t[0]), c["vx"], c["road_wheel_angle"], np.arange(len(t)) % 2]
    write_table(tmp_path / "log.csv", columns, "s_m,vx_mps,steer_rad,steering_pressed\n")
    text = proposed(tmp_path, "log.csv", capsys)[1]
    assert "column: steering_pressed" not in text
    assert "time: {step: 10 ms}  # no column increases" in text


def test_a_data_file_is_not_overwritten(tmp_path, capsys):
    t, c = truth()
    write_table(tmp_path / "log.csv", [t, c["vx"]], "time [s],vx [m/s]\n")
    (tmp_path / "log.yaml").write_text("mine\n", encoding="utf-8")
    assert main(["identify", "new", str(tmp_path / "log.csv")]) == 2
    assert "exists already; give --out FILE.yaml" in capsys.readouterr().err
    assert main(["identify", "new", str(tmp_path / "log.csv"), "--force"]) == 0
    assert "missing for a fit of the steering: the steering" in capsys.readouterr().out
    assert list(load_data(tmp_path / "log.yaml").logs[0].channels) == ["vx"]


@pytest.mark.parametrize(
    ("column", "expected"),
    [
        ("Gierrate", "yaw_rate"), ("IMU.Gyro_Z", "yaw_rate"), ("yawRate", "yaw_rate"), ("psi_dot", "yaw_rate"),
        ("Gierwinkelgeschwindigkeit", "yaw_rate"), ("wz", "yaw_rate"), ("Lenkradwinkel", "steering_wheel_angle"),
        ("SteeringWheelAngle", "steering_wheel_angle"), ("Längsgeschwindigkeit", "vx"),
        ("lat_acc", "lateral_acceleration"), ("delta_soll", "steering_command"), ("comment", None),
        ("GPS Speed", "speed"), ("v_kmh", "speed"), ("Radgeschwindigkeit VL", "wheel_speed_front_left"),
        ("Lenkwinkelgeschwindigkeit", None), ("Breitengrad", "latitude"), ("Querneigung", "bank"),
        ("FahrpedalStellung", "throttle"), ("brake_pressure", "brake"), ("Motordrehzahl", "engine_speed"),
        ("accel_pedal", "throttle"), ("target_lane", None), ("heading", "yaw"), ("v_z", None),
        ("ego.speed_trim", None), ("ego.heading_error", None), ("yaw_rate_std", None), ("vEgo", "speed"),
        ("rpm_fl", "wheel_rate_front_left"), ("speed_rr", "wheel_speed_rear_right"),
        ("G Force Lat", "lateral_acceleration"),
        ("LonAcc", "longitudinal_acceleration"), ("z_rate_of_rotation", "yaw_rate"), ("latAccelSteeringAngle", None),
        ("twist.linear.x", "vx"), ("pose.position.x", "x"), ("car.vx.Value", "vx"), ("speed (column 3)", "speed"),
    ],
)  # fmt: skip
def test_names_of_columns(column, expected):
    assert channel_by_name(column) == expected
    assert expected is None or expected in CHANNELS


def test_signals_of_a_run_have_their_channels_by_the_registry():
    state = [f"rover.{signal.name}" for signal in STATE]
    imu = [f"rover.imu.{name}" for name in ("fx", "fy", "fz", "wx", "wy", "wz")]
    others = ["rover.speed_trim", "rover.heading_error", "rover.speed_setpoint", "rover.wheel_torque.rear_left"]
    wheels = ["rover.steering_angle.left", "rover.wheel_load.front_left", "rover.wheel_speed.front_left"]
    found = channels_of_run([*state, "other.x", *imu, *others, *wheels])
    assert found is not None
    assert found["rover.wz"] == "yaw_rate"
    assert found["rover.imu.wz"] == "yaw_rate@imu"
    directions = ("longitudinal", "lateral", "vertical")
    assert [found[name] for name in imu[:3]] == [f"{direction}_acceleration" for direction in directions]
    expected = ["road_wheel_angle_left", "tyre_force_z_front_left", "wheel_rate_front_left"]
    assert [found[name] for name in wheels] == expected
    assert not {*others, "rover.z", "other.x"} & found.keys()
    assert all(quantity(name) in CHANNELS for name in found.values())
    assert channels_of_run(["car.x", "car.y", "car.vx"]) is None


@pytest.mark.parametrize(
    ("unit", "expected"), [("m/s²", "lateral_acceleration"), ("g", "lateral_acceleration"), ("N", None)]
)
def test_a_specific_force_is_an_acceleration(unit, expected):
    assert channel_by_name("imu.fy", unit) == expected


def test_a_data_file_may_be_written_into_another_folder(tmp_path):
    t, c = truth()
    (tmp_path / "logs").mkdir()
    (tmp_path / "data").mkdir()
    columns = [t[:500], c["vx"][:500], c["yaw_rate"][:500]]
    write_table(tmp_path / "logs" / "a.csv", columns, "time,vx_m_s,yaw_rate_rad_s\n")
    assert main(["identify", "new", str(tmp_path / "logs" / "a.csv"), "--out", str(tmp_path / "data" / "a.yaml")]) == 0
    assert '{file: "../logs/a.csv"}' in (tmp_path / "data" / "a.yaml").read_text(encoding="utf-8")
    (log,) = load_data(tmp_path / "data" / "a.yaml").logs
    agree(log, c, ("vx", "yaw_rate"), slice(500))


@pytest.mark.parametrize(
    ("column", "si", "expected"),
    [("v_kmh", "m/s", "km/h"), ("a_y_g", "m/s^2", "g"), ("gyro_z_deg_s", "rad/s", "deg/s"), ("yaw", "rad", None),
     ("vx_m_s", "m/s", "m/s"), ("steer_deg", "rad", "deg"), ("speed_g", "m/s", None), ("throttle_pct", "1", "%")],
)  # fmt: skip
def test_units_at_the_end_of_names(column, si, expected):
    assert unit_by_name(column, si) == expected


def test_a_banked_road_explains_its_part_of_the_lateral_acceleration():
    log = recorded(4)
    bank = 0.2 * np.sin(0.4 * log.time)
    banked = changed(log, lateral_acceleration=log.channels["lateral_acceleration"] + G * np.sin(bank))

    relation = ("kinematics", "lateral_acceleration, vx, yaw_rate")
    (finding,) = checked(changed(banked, bank=bank)).of(*relation)
    assert (finding.value, finding.severity) == (pytest.approx(1.0, abs=0.02), "info")
    # Without the bank both sides agree less well.
    assert all(abs(other.value - 1.0) > 0.1 for other in checked(banked).of(*relation))


@pytest.mark.parametrize("kind", ["ros1", "sqlite"])
def test_a_bag_of_ros_is_proposed(tmp_path, capsys, kind):
    """Gaps of a slower topic are no reason against it."""
    bags = pytest.importorskip("tests.test_identification_data_bags")
    log, text = proposed(tmp_path, bags.write_ros(tmp_path, kind), capsys)
    assert log.channels["yaw_rate"] == pytest.approx(bags.rates(log.time))
    known = np.isfinite(log.channels["vx"])
    assert log.channels["vx"][known] == pytest.approx(2.0 + log.time[known])
    assert "gear: {column: /gear:data}" in text.replace('"', "")


def test_the_vehicle_of_a_run_gives_wheelbase_mass_and_centre_of_mass(tmp_path, capsys):
    run = tmp_path / "drive"
    car = {"world": "empty", "vehicles": {"car": {"model": "bolt", "speed": 8.0}}, "plant": {"contact": "point"}}
    car["control"] = {"car": {"kind": "constant", "speed": 8.0}}
    mir.simulate({**car, "record": {"meshcat": False, "report": False}}, duration=0.5, folder=run)
    assert main(["identify", "new", str(run)]) == 0
    assert "wheelbase: 2.60" in capsys.readouterr().out
    parameters = estimate_parameters(load_vehicle("bolt"))
    spec = load_yaml(tmp_path / "drive.yaml", DataSpec)
    assert spec.wheelbase == pytest.approx(load_vehicle("bolt").geometry.wheelbase, rel=1e-5)
    assert spec.mass == pytest.approx(parameters.mass, rel=1e-5)
    assert spec.front_length == pytest.approx(parameters.front_length, rel=1e-5)
    assert spec.front_drive == 1.0
    assert spec.front_brake == pytest.approx(parameters.front_brake, rel=1e-5)
    # With --out, a summary replaces the text of the file.
    assert main(["identify", "new", str(run), "--out", str(tmp_path / "named.yaml")]) == 0
    shown = capsys.readouterr().out
    assert f"vehicle 'car': wheelbase {spec.wheelbase:.4g} m, mass {spec.mass:.4g} kg" in shown
    assert f"{len(spec.channels)} channels, " in shown
    assert "column:" not in shown
    assert load_yaml(tmp_path / "named.yaml", DataSpec).channels == spec.channels
    # A run without its scene is a log like any other.
    rmtree(run / "scene")
    assert main(["identify", "new", str(run), "--force"]) == 0
    assert load_yaml(tmp_path / "drive.yaml", DataSpec).wheelbase is None


def test_what_the_data_file_knows_of_the_vehicle_is_fixed_in_a_fit_without_a_study(tmp_path):
    t, c = truth()
    names = ("vx", "yaw_rate", "road_wheel_angle")
    write_table(tmp_path / "log.csv", [t, *(c[name] for name in names)], "time,vx,yaw_rate,road_wheel_angle\n")
    units = {"vx": "m/s", "yaw_rate": "rad/s", "road_wheel_angle": "rad"}
    channels = {name: {"column": name, "unit": unit} for name, unit in units.items()}
    vehicle = {"wheelbase": "2.7 m", "mass": "1500 kg", "front_length": "1.2 m", "front_drive": 0.0}
    content = {"mirdrake": "data/1", **vehicle, "channels": channels, "logs": [{"file": "log.csv"}]}
    (tmp_path / "log.yaml").write_text(json.dumps(content), encoding="utf-8")
    parameters = default_study(tmp_path / "log.yaml").parameters
    assert {name: entry.fixed for name, entry in parameters.items()} == {
        "mass": 1500.0, "front_length": 1.2, "front_drive": 0.0,
    }  # fmt: skip
