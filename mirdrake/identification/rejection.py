"""Rejection of data sets in which a unit or sign of a channel of the model is wrong."""

from collections.abc import Collection

from mirdrake.core.errors import ConfigError
from mirdrake.identification.findings import DataReport, Finding

_SPEED = {"vx", "speed"}


def reject_faults(report: DataReport, used: Collection[str]) -> None:
    """Reject data whose units or signs cannot be right: a fit to them would be meaningless.

    Where several channels could be wrong, and the model does not use one of them, the data are accepted.

    Args:
        report: report of the data check.
        used: channels of the model.

    Raises:
        ConfigError: one line per fault, with what to write.
    """
    faults = [finding for finding in report.unrepaired_faults if finding.check in {"units", "sample_time"}]
    # The steering is compared with speed and yaw rate: if those may be wrong, the steering is not to blame.
    doubtful = {
        name for fault in faults if len(fault.channels) > 1 or "yaw_rate" in fault.channels for name in fault.channels
    }
    by_channel: dict[tuple[str, str], list[Finding]] = {}
    for fault in faults:
        # If one of several suspects is not a channel of the model, the fault may be there.
        if fault.channels and not set(fault.channels) <= set(used):
            continue
        if fault.what.code == "steering_sign" and doubtful & {"yaw_rate", *_SPEED}:
            continue
        by_channel.setdefault((fault.check, fault.channel), []).append(fault)
    # A fault of one channel explains those of groups that contain it.
    single = {channel for _, channel in by_channel if ", " not in channel}
    lines = []
    for (_, channel), same in by_channel.items():
        if channel not in single and not single.isdisjoint(same[0].channels):
            continue
        logs = same[0].log + (f" and {len(same) - 1} more" if len(same) > 1 else "")
        prefix = f"{channel}: " if channel else ""
        lines.append(f"{logs}: {prefix}{same[0].text}; {_correction(same[0])}, or set 'force: true' in the study")
    if lines:
        raise ConfigError("\n".join(lines))


def _correction(fault: Finding) -> str:
    """Return what to write in the data file."""
    if fault.check == "sample_time":
        return "give 'unit' or 'step' under 'time' of the data file, or allow the repair 'sample_time'"
    names = " or ".join(fault.channels)
    if fault.what.code in {"steering_sign", "velocity_sign", "path_direction"} or fault.what.figures.get("signs_only"):
        return f"write 'sign: -1' at {names} in 'channels' of the data file"
    return f"correct 'unit' or 'sign' of {names} in 'channels' of the data file"
