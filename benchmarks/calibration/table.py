"""Table of a calibration as Markdown."""

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from benchmarks.calibration.run import ParameterRow, Row

CLEAR = 0.1
"""Relative error from which a parameter called identified is wrong, if its interval does not contain the truth [1]."""

CLOSE = 0.06
"""Relative error and standard deviation by noise below which "not identifiable" is wrong [1]."""

DETERMINED = 5.0
"""Standard deviation of a prediction by the parameters below which the training logs determine it [%]."""

FITTED_KINDS = frozenset({"linear", "brush", "magic"})
"""Truths that the fitted model contains."""

OTHER_KINDS = frozenset({"two_track", "multi_body"})
"""Truths with effects that the fitted model lacks."""

KINDS = FITTED_KINDS | OTHER_KINDS

VERDICTS = ("identified", "weakly identified", "not identifiable")


def is_covered(parameter: "ParameterRow") -> bool:
    """Return whether the interval contains the truth; an open end does."""
    low, high = parameter["low"], parameter["high"]
    return (low is None or low <= parameter["truth"]) and (high is None or parameter["truth"] <= high)


def relative_error(parameter: "ParameterRow") -> float:
    """Return the error over the truth; over the usual size of delays and positions for those."""
    usual = {"steering_delay": 0.1, "steering_lag": 0.1, "accelerometer_ahead": 1.0, "velocity_ahead": 1.0}
    size = max(abs(parameter["truth"]), usual.get(parameter["name"], 0.0), 1e-12)
    return abs(parameter["value"] - parameter["truth"]) / size


def is_false_not_identifiable(parameter: "ParameterRow") -> bool:
    """Return whether the noise and the error are small although the parameter is called not identifiable."""
    noise = parameter["noise"]
    is_small = noise is not None and noise < CLOSE * abs(parameter["value"])
    return parameter["verdict"] == "not identifiable" and is_small and relative_error(parameter) < CLOSE


def _share(count: int, total: int) -> str:
    return f"{100.0 * count / total:.0f} % ({count} of {total})" if total else "-"


def make_table(rows: Sequence["Row"]) -> str:
    """Return coverage by parameter and verdict, and the rates of wrong decisions."""
    driven = [row for row in rows if row["status"] != "not driven"]
    fitted = [row for row in driven if row["status"] == "fitted"]
    bad = {"sign", "degrees"}
    clean = [row for row in driven if row["fault"] not in bad | {"vy_sign"}]
    wrong = [row for row in driven if row["fault"] in bad]
    pairs = [
        (row, parameter) for row in fitted if row["fault"] not in bad | {"vy_sign"} for parameter in row["parameters"]
    ]
    called = [(row, entry) for row, entry in pairs if entry["verdict"] == "identified"]
    lines = ["| figure | value | target |", "|---|---|---|"]

    def add(name: str, value: str, target: str) -> None:
        lines.append(f"| {name} | {value} | {target} |")

    def coverage(kinds: Collection[str]) -> str:
        part = [entry for row, entry in called if row["kind"] in kinds]
        return _share(sum(map(is_covered, part)), len(part))

    add("cases (of these fitted)", f"{len(driven)} ({len(fitted)})", "")
    add("coverage, identified", coverage(KINDS), "90 to 99 %")
    add("coverage, identified, right model", coverage(FITTED_KINDS), "90 to 99 %")
    add("coverage, identified, other model", coverage(OTHER_KINDS), "90 to 99 %")
    count = sum(not is_covered(entry) and relative_error(entry) > CLEAR for _, entry in called)
    add("false identified", _share(count, len(called)), "")
    not_named = [entry for _, entry in pairs if entry["verdict"] == "not identifiable"]
    add("false not identifiable", _share(sum(map(is_false_not_identifiable, not_named)), len(not_named)), "0")
    add("called identified", _share(len(called), len(pairs)), "")
    checked = [row for row in fitted if row["fault"] not in bad]
    add("false delays", _share(sum(bool(row["false_delays"]) for row in checked), len(checked)), "2 %")
    add("false repairs", _share(sum(bool(row["false_repairs"]) for row in checked), len(checked)), "2 %")
    add("false rejections", _share(sum(row["status"] == "rejected" for row in clean), len(clean)), "1 %")
    late = [row for row in fitted if row["fault"] == "late"]
    add("delays not found", _share(sum(row["missed"] for row in late), len(late)), "")
    limited = [row for row in checked if row["limited"]]
    add("interval of a delay that is not found excludes the truth",
        _share(sum(bool(row["excluded"]) for row in limited), len(limited)), "5 %")  # fmt: skip
    add("wrong signs and units missed", _share(sum(row["status"] == "fitted" for row in wrong), len(wrong)), "0")
    turned = [row for row in driven if row["fault"] == "vy_sign"]
    missed = sum(row["status"] == "fitted" and row["missed"] for row in turned)
    add("wrong sign of vy missed", _share(missed, len(turned)), "0")
    compared = [(row["held_out"] - row["baseline"], row["prediction_sigma"]) for row in checked
                if row["held_out"] is not None and row["baseline"] is not None]  # fmt: skip
    gains = [gain for gain, _ in compared]
    if gains:
        add("validation, median over the baseline", f"{np.median(gains):+.1f} points", "> 0")
        add(
            "validation, worse than the baseline by 2 points",
            _share(sum(gain < -2.0 for gain in gains), len(gains)),
            "0",
        )
        known = [gain for gain, sigma in compared if sigma is not None and sigma < DETERMINED]
        add(
            f"the same where the parameters predict the log to {DETERMINED:g} %",
            _share(sum(gain < -2.0 for gain in known), len(known)),
            "0",
        )
        least = [gain / sigma for gain, sigma in compared if sigma]
        add("least difference over the stated deviation", f"{min(least, default=np.nan):.1f}", "> -2")
        add(
            "validation, median",
            f"{np.median([row['held_out'] for row in checked if row['held_out'] is not None]):.1f} %",
            "",
        )
    add("processor time, median", f"{np.median([row['seconds'] for row in driven]):.0f} s", "")

    # Coverage by parameter and verdict.
    lines += [
        "",
        "| parameter | " + " | ".join(f"{verdict}: covered" for verdict in VERDICTS) + " |",
        "|---|---|---|---|",
    ]
    for name in dict.fromkeys(entry["name"] for _, entry in pairs):
        cells = []
        for verdict in VERDICTS:
            part = [entry for _, entry in pairs if entry["name"] == name and entry["verdict"] == verdict]
            cells.append(_share(sum(map(is_covered, part)), len(part)))
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)
