"""Proposal of a data file as YAML with the guesses as comments."""

import json
import re

from mirdrake.identification.channels import channel
from mirdrake.identification.proposals import DataProposal, Other, Proposal

_PLAIN = re.compile(r"[A-Za-z_/][\w./]*")
_WORDS = {"yes", "no", "on", "off", "true", "false", "null", "y", "n"}
"""Plain texts that YAML reads as switches."""

MAX_OTHERS = 60
"""Largest number of columns without a channel that are listed."""


def proposal_text(proposal: DataProposal, log: str | None = None) -> str:
    """Return the data file of a proposal.

    Args:
        proposal: channels, clock and file.
        log: path of the log from the folder of the data file; None if the log is in it.
    """
    lines = [
        "mirdrake: data/1",
        f"# Proposed by mirdrake identify new for {proposal.file.name}: check every line. Values are positive forward,",
        "# to the left and up (ISO 8855): a left turn has a positive yaw rate, lateral acceleration and steering.",
        *(f"# {note}" for note in proposal.notes),
        *_known(proposal),
        "# clock: yaw_rate              # a channel without delay; found by the data check if left out",
    ]
    # Without a time column the step is a guess, which the remark states.
    if proposal.time is None:
        lines.append(f"time: {{step: 10 ms}}  # {proposal.time_reason}")
    else:
        unit = f", unit: {_scalar(proposal.time_unit)}" if proposal.time_unit else ""
        lines.append(f"time: {{column: {_scalar(proposal.time)}{unit}}}  # {proposal.time_reason}")
    lines.append("channels:")
    lines += _aligned([(f"  {_entry(item)}", _remark(item)) for item in proposal.channels])
    if proposal.others:
        lines.append("# Columns without a channel: unit, range")
        lines += [f"#   {_other(other)}" for other in proposal.others[:MAX_OTHERS]]
        more = len(proposal.others) - MAX_OTHERS
        lines += [f"#   and {more} more"] if more > 0 else []
    lines += ["logs:", f"  - {{file: {_scalar(log or proposal.file.name)}}}  # start: 2 s, end: 40 s, use: validation"]
    return "\n".join(lines) + "\n"


def _known(proposal: DataProposal) -> list[str]:
    """Return the dimensions of the vehicle, as comments if they are not known."""
    vehicle = proposal.vehicle
    if vehicle is None:
        return [
            "# wheelbase: 2.7 m             # if you know it: the steering is checked with it",
            "# mass: 1500 kg                # if you know it: else stiffness and inertia are per kilogram",
            "# front_drive: 1               # 1: front-wheel drive, 0: rear-wheel drive",
        ]
    source = f"# of vehicle '{vehicle.name}' of the run"
    rows = (
        ("wheelbase", vehicle.wheelbase, "m"),
        ("mass", vehicle.mass, "kg"),
        ("front_length", vehicle.front_length, "m"),
        ("front_drive", vehicle.front_drive, ""),
        ("front_brake", vehicle.front_brake, ""),
    )
    return [f"{f'{key}: {value:.6g} {unit}'.strip():28}  {source}" for key, value, unit in rows]


def _entry(item: Proposal) -> str:
    sign = ", sign: -1" if item.sign < 0 else ""
    # A unit that the file states must not be stated twice in another spelling; a pure number needs none.
    unit = "" if item.unit_in_file or item.unit in {"-", "1"} else f", unit: {_scalar(item.unit)}"
    key = item.channel if "@" not in item.channel else _scalar(item.channel)
    return f"{key}: {{column: {_scalar(item.column)}{unit}{sign}}}"


def _remark(item: Proposal) -> str:
    return f"{channel(item.channel).meaning}; by {', '.join(item.reasons)}"


def _other(other: Other) -> str:
    unit = f" {other.unit}" if other.unit else ""
    return f"{_scalar(other.column)}: {other.low:.4g} to {other.high:.4g}{unit}"


def _aligned(rows: list[tuple[str, str]]) -> list[str]:
    width = min(max((len(entry) for entry, _ in rows), default=0), 70)
    return [f"{entry:{width}}  # {remark}" for entry, remark in rows]


def _scalar(text: str) -> str:
    """Return a text as a YAML scalar, quoted where it must be."""
    is_plain = _PLAIN.fullmatch(text) and text.lower() not in _WORDS
    return text if is_plain else json.dumps(text, ensure_ascii=False)
