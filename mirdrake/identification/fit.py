"""Result of a fit: parameters with intervals and verdicts, fits of the channels, traces; saved and loaded."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError, first_line
from mirdrake.core.files import write_file
from mirdrake.core.json_io import Json, finite_or_none, parse_json, plain_data
from mirdrake.core.wording import plural
from mirdrake.readers.units import format_unit

Array = NDArray[np.float64]
Verdict = Literal["identified", "weakly identified", "not identifiable", "contradicts the given value", "fixed"]

FORMAT = "identification-fit/1"


@dataclass(frozen=True)
class FittedParameter:
    """Parameter of the model after the fit.

    Attributes:
        name: as in the model.
        unit: unit of value, sigma, low, high and given.
        value: the estimate, or the fixed value.
        sigma: standard deviation by noise and model; None if fixed or infinite.
        low: lower end of the 95 % interval; None if fixed or open.
        high: upper end; None as for low.
        kind: setting of the study.
        at_bound: bound that the estimate is at.
        given: value of the vehicle or the user.
        source: source of a fixed value, a prior or the given value.
        verdict: verdict on the value.
        explanation: reason of the verdict.
        sigma_noise: standard deviation by the noise of the logs [unit]; None as for sigma.
        sigma_model: standard deviation by omitted effects and assumptions [unit]; None if fixed or not analysed.
    """

    name: str
    unit: str
    value: float
    sigma: float | None = None
    low: float | None = None
    high: float | None = None
    kind: Literal["fixed", "free", "prior"] = "free"
    at_bound: Literal["low", "high"] | None = None
    given: float | None = None
    source: str = ""
    verdict: Verdict = "identified"
    explanation: str = ""
    sigma_noise: float | None = None
    sigma_model: float | None = None


@dataclass(frozen=True)
class ChannelFit:
    """Fit of one channel of one log.

    Attributes:
        log: name of the log.
        part: "train", or "validation" for a log that was not used for the estimates.
        channel: name of the channel.
        unit: its unit.
        nrmse_percent: 100 (1 - |y - model| / |y - mean y|) [%].
        noise_limit_percent: largest fit that the noise of the sensor allows [%].
        rms: root mean square of the residual [unit].
        whiteness_p: p-value of the hypothesis of white residuals (Ljung-Box) [1].
        input_correlation_p: p-value of the hypothesis of residuals uncorrelated with the inputs [1].
        prediction_sigma_percent: standard deviation of the prediction by the uncertainty of the parameters, over that
            of the measured values [%]; None for training.
    """

    log: str
    part: Literal["train", "validation"]
    channel: str
    unit: str
    nrmse_percent: float
    noise_limit_percent: float
    rms: float
    whiteness_p: float | None = None
    input_correlation_p: float | None = None
    prediction_sigma_percent: float | None = None


@dataclass(frozen=True)
class Fit:
    """A model fitted to a data set.

    Attributes:
        name: name of the study.
        model: kind of the model and its options.
        estimator: description of the estimator.
        parameters: all parameters of the model, including fixed ones.
        correlation: correlations of the free parameters, in their order (free x free) [1].
        condition_number: condition number of the scaled Fisher information; if large, some combination is not
            identified.
        channels: fits by log and channel.
        traces: traces by log: t [s], each channel, and the model's with "_model" in its name.
        profiles: profiles by parameter: value, cost (rise of -2 ln likelihood above its minimum, allowing for
            autocorrelated residuals; 3.84 is the end of the 95 % interval).
        combinations: what is identified, if single parameters are not.
        advice: manoeuvres that would help.
        notes: further remarks.
        data_sha256: digest of the data set.
        seconds: duration of the fit [s].
        versions: versions of the packages.
    """

    name: str
    model: str
    estimator: str
    parameters: tuple[FittedParameter, ...]
    correlation: Array
    condition_number: float
    channels: tuple[ChannelFit, ...] = ()
    traces: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    profiles: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    combinations: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    data_sha256: str = ""
    seconds: float = 0.0
    versions: Mapping[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> FittedParameter:
        """Return a parameter by name."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def free(self) -> tuple[FittedParameter, ...]:
        """Estimated parameters, in the order of the correlation."""
        return tuple(parameter for parameter in self.parameters if parameter.kind != "fixed")

    def channel(self, name: str, *, part: str = "validation", log: str | None = None) -> ChannelFit:
        """Return the fit of a channel in a part of the data: the first that matches.

        Raises:
            KeyError: none matches.
        """
        for item in self.channels:
            if item.channel == name and item.part == part and log in (None, item.log):
                return item
        raise KeyError(name)

    def table(self) -> str:
        """Return parameters, fits, combinations, advice and notes as plain text."""
        rows: list[tuple[str, ...]] = [(
            "parameter", "value", "95 % interval", "± noise", "± model", "unit", "given", "verdict"
        )]  # fmt: skip
        for parameter in self.free:
            span = f"{_number(parameter.low)} … {_number(parameter.high)}"
            parts = [half_width(sigma) for sigma in (parameter.sigma_noise, parameter.sigma_model)]
            rows.append(
                (
                    parameter.name,
                    _number(parameter.value),
                    span,
                    *parts,
                    format_unit(parameter.unit),
                    _number(parameter.given, ""),
                    parameter.verdict,
                )
            )
        lines = [f"{self.name}: {self.model}, {self.estimator}", "", *_columns(rows), ""]
        # A fixed parameter has no interval, but its value belongs to the result.
        fixed = [parameter for parameter in self.parameters if parameter.kind == "fixed"]
        if fixed:
            values = (
                f"{item.name} {_number(item.value)} {format_unit(item.unit)}".removesuffix(" 1") for item in fixed
            )
            lines += [f"{plural(len(fixed), 'fixed parameter')}: {', '.join(values)}", ""]
        lines += [
            f"{parameter.name}: {parameter.explanation}"
            for parameter in self.parameters
            if parameter.explanation and parameter.kind != "fixed"
        ]
        if self.channels:
            rows = [
                (
                    "log",
                    "part",
                    "channel",
                    "fit %",
                    "noise limit",
                    "± % by parameters",
                    "rms",
                    "unit",
                    "white p",
                    "inputs p",
                )
            ]
            rows += [
                (channel.log, channel.part, channel.channel,
                 f"{channel.nrmse_percent:.1f}", f"{channel.noise_limit_percent:.0f}",
                 half_width(channel.prediction_sigma_percent),
                 _number(channel.rms), format_unit(channel.unit),
                 _number(channel.whiteness_p, "", 2), _number(channel.input_correlation_p, "", 2))
                for channel in self.channels
            ]  # fmt: skip
            lines += ["", *_columns(rows)]
        for title, texts in (("Identified:", self.combinations), ("Advice:", self.advice), ("Notes:", self.notes)):
            lines += ["", title, *(f"  {text}" for text in texts)] if texts else []
        return "\n".join(lines)

    def save(self, folder: Path | str) -> Path:
        """Write fit.json, traces.parquet and profiles.parquet.

        Args:
            folder: created if it does not exist.

        Returns:
            The folder.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        for name, frames, key in (("traces", self.traces, "log"), ("profiles", self.profiles, "parameter")):
            # Tables of all logs, or parameters, are stored in one file with a column of labels.
            parts = [frame.assign(**{key: label}) for label, frame in frames.items()]
            table = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame({key: pd.Series(dtype=str)})
            write_file(folder / f"{name}.parquet", table.to_parquet(index=False))
        content: Json = {"mirdrake": FORMAT}
        for item in fields(self):
            if item.name not in {"traces", "profiles"}:
                content[item.name] = getattr(self, item.name)
        content["parameters"] = [asdict(parameter) for parameter in self.parameters]
        content["channels"] = [asdict(channel) for channel in self.channels]
        # Arrays and nested data classes become plain lists; NaN and infinity, which JSON does not have, become null.
        content["correlation"] = self.correlation.tolist()
        content["versions"] = dict(self.versions)
        text = json.dumps(plain_data(content, finite_or_none), indent=1, ensure_ascii=False, allow_nan=False)
        write_file(folder / "fit.json", (text + "\n").encode())
        return folder


def load_fit(folder: Path | str) -> Fit:
    """Load a saved fit.

    Raises:
        ConfigError: the fit does not exist, or has another format.
    """
    file = Path(folder) / "fit.json"
    try:
        content = parse_json(file.read_text(encoding="utf-8"))
        tables = {name: pd.read_parquet(file.parent / f"{name}.parquet") for name in ("traces", "profiles")}
    except OSError as error:
        # Every damage of the file ends in one line with the same advice: the study can be run again.
        raise ConfigError(f"no saved fit ({error.strerror or error}); run the study again", where=str(file)) from None
    except ValueError as error:
        raise ConfigError(f"is damaged ({first_line(error)}); run the study again", where=str(file)) from None
    if not isinstance(content, dict) or content.pop("mirdrake", None) != FORMAT:
        raise ConfigError(f"is not of format '{FORMAT}'; run the study again", where=str(file))
    try:
        content["parameters"] = tuple(FittedParameter(**entry) for entry in content["parameters"])
        content["channels"] = tuple(_channel_fit(entry) for entry in content["channels"])
        content["correlation"] = np.array(content["correlation"], dtype=np.float64).reshape(
            len(content["correlation"]), -1
        )
        # Null stands for infinity here, the condition number of an unidentified combination.
        if content["condition_number"] is None:
            content["condition_number"] = math.inf
        for name in ("combinations", "advice", "notes"):
            content[name] = tuple(content[name])
        return Fit(
            **content,
            traces=_apart(tables["traces"], "log"),
            profiles=_apart(tables["profiles"], "parameter"),
        )
    except (KeyError, TypeError) as error:
        raise ConfigError(f"is damaged ({error}); run the study again", where=str(file)) from None


def _apart(table: pd.DataFrame, key: str) -> dict[str, pd.DataFrame]:
    """Return the rows of a table by label, without empty columns."""
    tables = {}
    for label, rows in table.groupby(key, sort=False):
        tables[str(label)] = rows.drop(columns=key).dropna(axis="columns", how="all").reset_index(drop=True)
    return tables


def half_width(sigma: float | None) -> str:
    """Return half of a 95 % interval for a standard deviation; empty without one."""
    return _number(None if sigma is None else 1.96 * sigma, "", 2)


def _channel_fit(content: Mapping[str, Any]) -> ChannelFit:
    """Return a channel from its plain data: null becomes NaN."""
    numbers = {name: math.nan for name in ("nrmse_percent", "noise_limit_percent", "rms") if content[name] is None}
    return ChannelFit(**{**content, **numbers})


def _number(value: float | None, none: str = "open", digits: int = 4) -> str:
    return none if value is None else f"{value:.{digits}g}"


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
