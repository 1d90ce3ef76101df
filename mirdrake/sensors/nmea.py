"""NMEA 0183 sentences of a GPS receiver: GGA and RMC."""

from datetime import UTC, datetime, timedelta
from typing import NamedTuple

KNOT = 1852.0 / 3600.0
"""[m/s]"""

_SATELLITES, _HDOP = 12, 0.8  # typical of an open sky; satellites are not simulated


class Fix(NamedTuple):
    """Data of one fix.

    Attributes:
        time: since 1970-01-01 00:00:00 UTC [s].
        latitude: [deg] north.
        longitude: [deg] east.
        altitude: [m] above the ellipsoid, which is assumed to be the sea level: the separation of the geoid is 0.
        speed: over ground [m/s].
        course: course of the velocity [deg], clockwise from true north.
        quality: 1 a single fix, 2 differential, 4 RTK.
    """

    time: float
    latitude: float
    longitude: float
    altitude: float
    speed: float = 0.0
    course: float = 0.0
    quality: int = 1


def gga(fix: Fix) -> str:
    """Return the sentence GGA with its end of line: time, position and quality of a fix."""
    clock, _ = _clock(fix.time)
    position = f"{_angle(fix.latitude, 'NS', 2)},{_angle(fix.longitude, 'EW', 3)}"
    return _sentence(f"GPGGA,{clock},{position},{fix.quality},{_SATELLITES},{_HDOP},{fix.altitude:.3f},M,0.0,M,,")


def rmc(fix: Fix) -> str:
    """Return the sentence RMC with its end of line: time, date, position, speed [knots] and course of a fix."""
    clock, date = _clock(fix.time)
    position = f"{_angle(fix.latitude, 'NS', 2)},{_angle(fix.longitude, 'EW', 3)}"
    # 359.996 deg is rounded to 360.00, which NMEA does not allow; the remainder makes it 0.00.
    course = round(fix.course, 2) % 360.0
    mode = {2: "D", 4: "R"}.get(fix.quality, "A")
    return _sentence(f"GPRMC,{clock},A,{position},{fix.speed / KNOT:.3f},{course:.2f},{date},,,{mode}")


def checksum(body: str) -> str:
    """Return the checksum: exclusive or of all characters between $ and *, two hexadecimal digits."""
    total = 0
    for code in body.encode("ascii"):
        total ^= code
    return f"{total:02X}"


def _sentence(body: str) -> str:
    return f"${body}*{checksum(body)}\r\n"


def _clock(time: float) -> tuple[str, str]:
    """Return a time as hhmmss.ss and ddmmyy."""
    # Rounded to hundredths in whole milliseconds first, so that 59.999 s carries into the next minute.
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(milliseconds=10 * round(time * 100.0))
    return f"{moment:%H%M%S}.{moment.microsecond // 10_000:02d}", f"{moment:%d%m%y}"


def _angle(angle: float, letters: str, digits: int) -> str:
    """Return degrees and minutes (to 0.2 mm) in one number, and the hemisphere: 45.5 is ``4530.0000000,N``."""
    units = round(abs(angle) * 60e7)  # 1e-7 minutes, so that 59.99999999 becomes a degree
    minutes, fraction = divmod(units, 10_000_000)
    return f"{minutes // 60:0{digits}d}{minutes % 60:02d}.{fraction:07d},{letters[angle < 0.0]}"
