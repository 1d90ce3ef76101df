"""Channels and units by the names of columns, as people and instruments write them, in English, German and French."""

import re
import unicodedata
from collections.abc import Iterable, Mapping

from mirdrake.core.vectors import SIDES, STATE
from mirdrake.identification.channels import CHANNELS, WHEELS
from mirdrake.readers.tables import PLACE
from mirdrake.readers.units import is_unit, plain_unit, unit_factor

_COMMAND = r"(cmd|command|target|soll|desired|request|demand|set_?point|consigne)"
_SPEED, _STEER = r"(speed|vel|geschw|vitesse|v$)", r"(steer|lenk|delta|servo|spurwinkel|wheel_angle)"
_ACC, _GYRO = r"(acc|accel|acceleration|beschl)\w*", r"(gyro|gyr|angular|ang|rot|rotation|omega)\w*"
_TURN, _G = r"(rate|gyro|gyr)(_|$)", r"(^|_)g_(force)"
_TYRE = r"(tyre|tire|wheel|rad|reifen)"
_ERROR = r"(error|err|trim|deviation|residual|correction|abweichung|fehler|korrektur|ecart|erreur|std|stddev|variance)"

NAMES: tuple[tuple[str, str], ...] = (
    ("", rf"(^|_){_ERROR}(_|$)"),  # of a controller or an estimator: not the quantity itself
    ("speed_command", rf"{_COMMAND}.*{_SPEED}|(^v|speed|vel|geschw)[a-z_]*_{_COMMAND}"),
    ("steering_command", rf"{_COMMAND}.*{_STEER}|{_STEER}[a-z_]*_{_COMMAND}"),
    ("", _COMMAND),
    ("", rf"acc\w*{_STEER}|{_STEER}\w*_acc"),  # of two quantities: one is computed from the other
    ("wheel_speed", r"(wheel|rad|roue)_?(speed|geschw|vitesse|vel)|^(v|ws)_?(fl|fr|rl|rr|vl|vr|hl|hr)$"),
    ("wheel_rate", r"wheel_?(rate|omega|rpm)|rad_?drehzahl|omega_?(fl|fr|rl|rr|vl|vr|hl|hr)$"),
    ("tyre_force_x", rf"{_TYRE}.*(fx|force_x|long\w*_force|laengskraft)|^fx_?\w"),
    ("tyre_force_y", rf"{_TYRE}.*(fy|force_y|lat\w*_force|querkraft)|^fy_?\w"),
    ("tyre_force_z", rf"{_TYRE}.*(fz|force_z|vert\w*_force|aufstandskraft)|radlast|^fz_?\w"),
    ("steering_torque", r"(steer|lenk|hand_?wheel)\w*(torque|moment)"),
    ("", r"(steer|lenk)\w*(rate|speed|geschw|vel)"),
    ("road_wheel_angle_left", rf"{_STEER}\w*_(fl|vl|left|links|l)(_|$)|(left|links)\w*{_STEER}"),
    ("road_wheel_angle_right", rf"{_STEER}\w*_(fr|vr|right|rechts|r)(_|$)|(right|rechts)\w*{_STEER}"),
    ("steering_wheel_angle", r"steering_?wheel|hand_?wheel|lenkrad|volant|^swa$|^lrw"),
    ("road_wheel_angle", r"road_?wheel|wheel_?angle|steering_t[iy]re|radlenk|radwinkel|^delta(_f)?$"),
    ("steering", r"steer|lenk|braquage|servo"),
    (
        "yaw_rate",
        rf"(yaw|heading)_?(rate|vel|speed)|gier_?\w*(rate|geschw)|lacet|{_GYRO}_?z$|^w_?z$|psi_?(dot|p|punkt)|^r$"
        rf"|(^|_)z_(axis_)?{_TURN}|^(gps_)?gyro$",
    ),
    ("roll_rate", rf"roll_?(rate|vel)|wank_?\w*(rate|geschw)|roulis|{_GYRO}_?x$|^w_?x$|(^|_)x_(axis_)?{_TURN}"),
    ("pitch_rate", rf"pitch_?(rate|vel)|nick_?\w*(rate|geschw)|tangage|{_GYRO}_?y$|^w_?y$|(^|_)y_(axis_)?{_TURN}"),
    (
        "longitudinal_acceleration",
        rf"laengsbeschl|lon(g\w*)?_?acc|acc\w*_?lon|(^|_)a(cc)?_?x$|{_ACC}_x$|accel_?x|{_G}_lon|^a_?(ego|veh)$",
    ),
    ("lateral_acceleration", rf"querbeschl|lat(eral)?_?acc|acc\w*lat|(^|_)a(cc)?_?y$|{_ACC}_y$|accel_?y|{_G}_lat"),
    ("vertical_acceleration", rf"vert\w*acc|(^|_)a(cc)?_?z$|{_ACC}_z$|accel_?z|{_G}_vert"),
    ("engine_speed", r"rpm|engine_?speed|motor_?(drehzahl|speed)|drehzahl|regime"),
    ("vx", r"long\w*_?(vel|speed)|laengsgeschw|(^|_)v_?x$|(vel|velocity|speed|linear)\w*_x$"),
    ("vy", r"lat(eral)?_?(vel|speed)|quergeschw|(^|_)v_?y$|(vel|velocity|speed|linear)\w*_y$"),
    ("", r"(^|_)v_?z$|(vel|velocity|linear)\w*_z$"),
    ("speed", r"speed|geschw|vitesse|velocity|^v$|^v_?(car|veh|fzg|gps|ref|ist|ego)|^vel$"),
    ("latitude", r"^lat(itude)?$|latitude|breitengrad|(^|_)lat$"),
    ("longitude", r"^(lon|lng|long)(gitude)?$|longitude|laengengrad|(^|_)lon$"),
    ("sideslip", r"side_?slip|schwimmwinkel|^beta$|derive"),
    ("bank", r"bank|querneigung|cross_?slope|devers"),
    ("grade", r"grade|slope|steigung|laengsneigung|pente"),
    ("yaw", r"heading|^yaw|_yaw|gierwinkel|^psi$|kurswinkel|^kurs$"),
    ("roll", r"^roll|_roll|wankwinkel|rollwinkel"),
    ("pitch", r"^pitch|_pitch|nickwinkel"),
    ("throttle", r"throttle|fahrpedal|gaspedal|^gas$|accel\w*_?ped|accelerator|^apps"),
    ("brake_torque", r"(brake|brems)\w*(torque|moment)"),
    ("brake", r"brake|brems|frein"),
    ("drive_torque", r"(drive|wheel|axle|antrieb|rad)\w*(torque|moment)"),
    ("gear", r"^gear|gang$|^gang|rapport"),
    ("x", r"^x$|pos(ition)?_x$|east|utm_?e|rechtswert|^x_?(pos|m)"),
    ("y", r"^y$|pos(ition)?_y$|north|utm_?n|hochwert|^y_?(pos|m)"),
)
"""Channel, or part of its name, and pattern of a column, most specific first; an empty channel ends the search."""

SPECIFIC_FORCE = {
    "fx": "longitudinal_acceleration", "fy": "lateral_acceleration", "fz": "vertical_acceleration",
}  # fmt: skip
"""Channels of the specific force, which an accelerometer measures, by the end of the name of a column in m/s²."""

_ANGULAR_VELOCITY = {"wx": "roll_rate", "wy": "pitch_rate", "wz": "yaw_rate"}

SIGNALS: Mapping[str, str] = {
    **{name: name for name in ("x", "y", "roll", "pitch", "yaw", "vx", "vy")},
    **_ANGULAR_VELOCITY,
    **{f"steering_angle.{side}": f"road_wheel_angle_{side}" for side in SIDES},
    "speed_command": "speed_command",
    **{f"wheel_speed.{wheel}": f"wheel_rate_{wheel}" for wheel in WHEELS},
    **{f"tyre_fx.{wheel}": f"tyre_force_x_{wheel}" for wheel in WHEELS},
    **{f"tyre_fy.{wheel}": f"tyre_force_y_{wheel}" for wheel in WHEELS},
    **{f"wheel_load.{wheel}": f"tyre_force_z_{wheel}" for wheel in WHEELS},
}
"""Channels of the signals of a run; all other signals have none, such as those of a single wheel's torque."""

_IMU = {**SPECIFIC_FORCE, **_ANGULAR_VELOCITY}

TIME = re.compile(
    r"^(t|time|zeit|temps|time_?stamp|zeit_?stempel|elapsed\w*|rel\w*_time|sec|seconds|time_?s|utc\w*)$|(^|_)(time|zeit)$"
)

_WHEEL_MARKS = (
    r"(fl|vl|front_left|lf|vorne_links|avg)", r"(fr|vr|front_right|rf|vorne_rechts|avd)",
    r"(rl|hl|rear_left|lr|hinten_links|arg)", r"(rr|hr|rear_right|hinten_rechts|ard)",
)  # fmt: skip
_WHEELS = dict(zip(WHEELS, _WHEEL_MARKS, strict=True))

_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss"})


def plain_name(column: str) -> str:
    """Return a name in lower case with underscores: ``gyro_z`` for ``Gyro Z`` and ``imu.gyroZ``."""
    # Words of camel case are separated before the case is lost.
    text = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", column.strip().replace("kN", "kn")).lower().translate(_UMLAUTS)
    text = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return re.sub(r"[^a-z0-9]+", "_", text).strip("_")


def channels_of_run(columns: Iterable[str]) -> dict[str, str] | None:
    """Return the channels of a recording of mirdrake by column: of its first vehicle; None for another log.

    A recording has the whole state of a vehicle, such as ``ego.x`` to ``ego.wz``. The source of a second measurement is
    its sensor: ``yaw_rate@imu``.
    """
    names = list(columns)
    own = (name.removesuffix(".x") for name in names if name.endswith(".x"))
    vehicle = next((name for name in own if {f"{name}.{signal.name}" for signal in STATE} <= {*names}), None)
    if vehicle is None:
        return None
    found: dict[str, str] = {}
    for column in names:
        signal = column.removeprefix(f"{vehicle}.")
        sensor, _, last = signal.rpartition(".")
        target = SIGNALS.get(signal)
        # Sensors have all fields of an inertial measurement unit or none.
        if target is None and sensor and {f"{vehicle}.{sensor}.{field}" for field in _IMU} <= {*names}:
            target = _IMU.get(last)
            if target in found.values():
                target = f"{target}@{sensor.replace('.', '_')}"
        if target is not None and signal != column:
            found[column] = target
    return found


def channel_by_name(column: str, unit: str = "") -> str | None:
    """Return the channel of a column by its name; ``steering`` if it may be several of them; None if unknown.

    Args:
        column: name of the column.
        unit: stated unit; "" without one.
    """
    # Tyre forces and specific forces have the same names.
    if (force := SPECIFIC_FORCE.get(plain_name(column.rpartition(".")[2]))) and fits(unit, "m/s^2"):
        return force
    column = PLACE.sub("", column)
    # The device before a dotted name counts only if the rest has no meaning, or is the component of a vector.
    names = [plain_name(column.rpartition(".")[2]), plain_name(column)]
    for name in dict.fromkeys(names[::-1] if names[0] in {"x", "y", "z"} else names):
        if name in CHANNELS and not (name in _ANGLES and fits(unit, "rad/s")):
            return name
        bare = re.sub(rf"_({'|'.join(_SUFFIXES)})$", "", name)
        found = next((channel for channel, pattern in NAMES if re.search(pattern, bare)), None)
        if found == "":
            return None
        if found in {"wheel_speed", "wheel_rate", "tyre_force_x", "tyre_force_y", "tyre_force_z"}:
            wheel = next(
                (wheel for wheel, mark in _WHEELS.items() if re.search(rf"(^|_|f[xyz]|v){mark}(_|$)", bare)), None
            )
            return f"{found}_{wheel}" if wheel else None
        if found in _BY_WHEEL and (wheel := _wheel_of(bare)):
            return f"{_BY_WHEEL[found]}_{wheel}"
        # A rate may have the name of its angle.
        if found in _ANGLES and fits(unit, "rad/s"):
            return f"{found}_rate"
        if found is not None:
            return found
    return None


_ANGLES = {"roll", "pitch", "yaw"}

_BY_WHEEL = {"engine_speed": "wheel_rate", "speed": "wheel_speed"}
"""Channels of a wheel whose name is that of the whole vehicle with the mark of a wheel, such as ``rpm_fl``."""


def _wheel_of(name: str) -> str | None:
    """Return the wheel that a name has as a word, such as front_left for ``ws_fl_rpm``."""
    return next((wheel for wheel, mark in _WHEELS.items() if re.search(rf"(^|_){mark}(_|$)", name)), None)


_SUFFIXES = (
    "kmh", "km_h", "kph", "mph", "mps", "m_s", "ms2", "mps2", "m_s2", "g", "deg", "rad", "grad", "degs", "deg_s", "dps",
    "rads", "rad_s", "rps", "s", "ms", "us", "ns", "m", "n", "kn", "nm", "pct", "percent", "ist", "mess", "filt", "raw",
    "act", "actual", "value", "val",
)  # fmt: skip
"""Units and remarks at the end of names."""

_SUFFIX_UNITS = {
    "km_h": "km/h", "m_s": "m/s", "ms2": "m/s^2", "m_s2": "m/s^2", "degs": "deg/s", "deg_s": "deg/s", "rads": "rad/s",
    "rad_s": "rad/s", "rps": "rad/s", "grad": "deg", "n": "N", "kn": "kN", "pct": "%", "percent": "%",
}  # fmt: skip


def unit_by_name(column: str, si: str) -> str | None:
    """Return the unit at the end of a name, such as km/h for ``v_kmh``, if it is one of a quantity; None without.

    Args:
        column: name of the column.
        si: SI unit of the quantity.
    """
    words = plain_name(column).split("_")
    for count in (2, 1):
        if len(words) <= count:
            continue
        suffix = "_".join(words[-count:])
        unit = _SUFFIX_UNITS.get(suffix, suffix)
        if fits(unit, si):
            return plain_unit(unit)
    return None


def fits(unit: str, si: str) -> bool:
    """Whether a text is a unit of a quantity."""
    try:
        unit_factor(unit, si)
    except ValueError:
        return False
    return bool(unit) and (si == "1" or is_unit(unit))
