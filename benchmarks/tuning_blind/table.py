"""Markdown table of the blind set."""

import math
from collections.abc import Sequence
from typing import Any

WORSE = 1.02
"""Largest ratio of the IAE to that of the present control that does not count as worse."""


def table_of(rows: Sequence[dict[str, Any]]) -> str:
    """Return the summary and a line per case."""
    lines = [
        "| loop, present control | cases | tuned | better than present | better than rule | unstable | worse | kept | "
        "kept though a candidate was better, within the constraints |"
    ]
    lines += ["|---|---|---|---|---|---|---|---|---|"]
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(f"{row['loop']}, {present_kind(row)}", []).append(row)
    for name in sorted(groups):
        lines.append(_summary(name, groups[name]))
    lines += [_summary("all", list(rows)), ""]
    lines += [
        "| case | kg | drive | delay [ms] | loop | present | verdict | tuned/present | worst | tuned/rule | missed | "
        "CPU [s] |"
    ]
    lines += ["|---|---|---|---|---|---|---|---|---|---|---|---|"]
    return "\n".join([*lines, *(_line(row) for row in rows)]) + "\n"


def present_kind(row: dict[str, Any]) -> str:
    """Return the kind of the present control of a loop."""
    if row["slip_tyres"]:
        return "pedals" if row["loop"] == "speed" else "servo"
    return "PID set by hand" if row["hand_set"] else "servo"


def ratios(row: dict[str, Any], other: str) -> list[float]:
    """Return the ratio of the tuned IAE to another one on each course; inf if the tuned loop alone is unstable."""
    iae = row.get("iae", {})
    if "tuned" not in iae or other not in iae:
        return []
    pairs = [(iae["tuned"][name], iae[other][name]) for name in iae["tuned"]]
    return [math.inf if tuned is None else 0.0 if given is None else tuned / given for tuned, given in pairs]


def mean_ratio(values: Sequence[float]) -> float:
    """Return the geometric mean; nan without values."""
    if not values:
        return math.nan
    return math.exp(sum(math.log(max(value, 1e-6)) for value in values) / len(values))


def _summary(name: str, rows: list[dict[str, Any]]) -> str:
    tuned = [row for row in rows if row["verdict"] == "tuned"]
    better = sum(mean_ratio(ratios(row, "present")) < 1.0 for row in tuned)
    ruled = [row for row in tuned if ratios(row, "rule")]
    beats = sum(mean_ratio(ratios(row, "rule")) <= 1.0 for row in ruled)
    unstable = sum(math.inf in ratios(row, "present") for row in tuned)
    worse = sum(mean_ratio(ratios(row, "present")) > WORSE for row in tuned)
    missed = [row["missed"] for row in rows if row.get("missed")]
    within = sum(bool(one["feasible"]) for one in missed)
    return (
        f"| {name} | {len(rows)} | {len(tuned)} | {better} | {beats} of {len(ruled)} | {unstable} | {worse} | "
        f"{sum(row['verdict'] == 'kept' for row in rows)} | {len(missed)}, {within} |"
    )


def _line(row: dict[str, Any]) -> str:
    present, rule = ratios(row, "present"), ratios(row, "rule")
    figures = [mean_ratio(present), max(present, default=math.nan), mean_ratio(rule)]
    texts = ["" if math.isnan(value) else "unstable" if math.isinf(value) else f"{value:.3f}" for value in figures]
    unmet = f" ({', '.join(row['unmet'])})" if row.get("unmet") else ""
    processor = f"{row.get('cpu_s', math.nan):.0f}"
    cells = [
        f"{row['seed']}.{row['number']}", f"{row['mass']:g}", row["drive"], f"{1e3 * row['delay']:.0f}", row["loop"],
        present_kind(row), f"{row['verdict']}{unmet or row.get('reason', '')}", *texts, _missed(row), processor,
    ]  # fmt: skip
    return f"| {' | '.join(str(cell) for cell in cells)} |"


def _missed(row: dict[str, Any]) -> str:
    """Return the rejected candidate that is better than the present control, its ratio, and why it was rejected."""
    found = row.get("missed")
    if not found:
        return ""
    return f"{found['name']} {found['ratio']:.3f} ({', '.join([*found['figures'], *found['checks']])})"
