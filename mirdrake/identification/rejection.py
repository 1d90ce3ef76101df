"""When a data set is not fitted: a unit or a sign of a channel that the model uses is wrong."""

from collections.abc import Collection

from mirdrake.core.errors import ConfigError
from mirdrake.identification.findings import DataReport, Finding

_SPEED = {"vx", "speed"}


def reject_faults(report: DataReport, used: Collection[str]) -> None:
    """Refuse data whose units or signs cannot be right: a fit to them would be one of nothing.

    Where several channels would explain what was seen, and the model does without one of them, it is not refused.

    Args:
        report: of the data check.
        used: channels of the model.

    Raises:
        ConfigError: one line per fault, with what to write.
    """
    faults = [one for one in report.unrepaired_faults if one.check in {"units", "step"}]
    # What the steering is compared with may be what is wrong: then the steering is not to be blamed.
    doubtful = {name for one in faults if len(_names(one)) > 1 or "yaw_rate" in one.channel for name in _names(one)}
    told: dict[tuple[str, str], list[Finding]] = {}
    for one in faults:
        names = _names(one)
        if names and not set(names) <= set(used):
            continue
        if "turns the vehicle to the" in one.text and doubtful & {"yaw_rate", *_SPEED}:
            continue
        told.setdefault((one.check, one.channel), []).append(one)
    single = {channel for _, channel in told if ", " not in channel}
    told = {key: found for key, found in told.items() if key[1] in single or single.isdisjoint(_names(found[0]))}
    lines = []
    for (check, channel), found in told.items():
        logs = found[0].log + (f" and {len(found) - 1} more" if len(found) > 1 else "")
        what = f"{channel}: " if channel else ""
        lines.append(f"{logs}: {what}{found[0].text}; {_cure(check, found[0])}, or set 'force: true' in the study")
    if lines:
        raise ConfigError("\n".join(lines))


def _names(found: Finding) -> list[str]:
    return [name for name in found.channel.split(", ") if name]


def _cure(check: str, found: Finding) -> str:
    """What is to be written in the data file."""
    if check == "step":
        return "give 'unit' or 'step' under 'time' of the data file, or allow the repair 'step'"
    names = " or ".join(_names(found))
    if "wrong sign" in found.text and " as " not in found.text:
        return f"write 'sign: -1' at {names} in 'channels' of the data file"
    return f"correct 'unit' or 'sign' of {names} in 'channels' of the data file"
