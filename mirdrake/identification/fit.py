"""What a fit gives: parameters with intervals and verdicts, fits per channel, traces; saved and read back."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError
from mirdrake.runs.logs import write_file

Array = NDArray[np.float64]
Verdict = Literal["identified", "weakly identified", "not identifiable", "contradicts the given value", "fixed"]

FORMAT = "identification-fit/1"


@dataclass(frozen=True)
class FittedParameter:
    """A parameter of the model after the fit.

    Attributes:
        name: as in the model.
        unit: of value, sigma, low, high and given.
        value: the estimate, or what it was fixed to.
        sigma: standard deviation, of noise and model together; None: fixed, or not to be had.
        low: lower end of the 95 % interval; None: fixed, or open.
        high: upper end; None as for low.
        kind: how the study took it.
        at_bound: which bound the estimate stands at.
        given: what the vehicle or the user says it is.
        source: where a fixed value, a prior or the given value is from.
        verdict: what is to be thought of the value.
        explanation: the reason in a sentence.
        sigma_noise: standard deviation by the noise of this log [unit]; None as for sigma.
        sigma_model: by what the model leaves out and what was assumed [unit]; None: fixed, or not asked.
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
    """How the model follows one channel of one log.

    Attributes:
        log: name of the log.
        part: "train", or "validation" for a log that the parameters have not seen.
        channel: name of the channel.
        unit: of it.
        nrmse_percent: 100 (1 - |y - model| / |y - mean y|) [%].
        noise_limit_percent: what the noise of the sensor leaves of that at most [%].
        rms: of the residual [unit].
        whiteness_p: probability of such residuals if they were white (Ljung-Box) [1].
        input_correlation_p: probability of such correlation with the inputs if there were none [1].
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


@dataclass(frozen=True)
class Fit:
    """A model fitted to a data set.

    Attributes:
        name: of the study.
        model: kind of the model and its options.
        estimator: how it was fitted, in explanation.
        parameters: all of the model, fixed ones too.
        correlation: of the free parameters, in their order (free x free) [1].
        condition_number: of the scaled Fisher information; large: some combination is not identified.
        channels: fits per log and channel.
        traces: by log: t [s], each channel, and the same with "_model" behind its name.
        profiles: by parameter: value, cost (rise of -2 ln likelihood over its least, residuals' autocorrelation
            taken into account; 3.84 is the end of the 95 % interval).
        combinations: what is identified, if single parameters are not.
        advice: which manoeuvre would help.
        notes: what else has to be known.
        data_sha256: of the data set.
        seconds: that it took [s].
        versions: of the packages.
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
        """A parameter by name."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def free(self) -> tuple[FittedParameter, ...]:
        """The parameters that were estimated, in the order of the correlation."""
        return tuple(parameter for parameter in self.parameters if parameter.kind != "fixed")

    def channel(self, name: str, *, part: str = "validation", log: str | None = None) -> ChannelFit:
        """The fit of a channel in a part of the data: the first that matches.

        Raises:
            KeyError: none matches.
        """
        for item in self.channels:
            if item.channel == name and item.part == part and log in (None, item.log):
                return item
        raise KeyError(name)

    def table(self) -> str:
        """Parameters, fits, combinations, advice and notes as plain text."""
        rows: list[tuple[str, ...]] = [(
            "parameter", "value", "95 % interval", "± of noise", "± of model", "unit", "given", "verdict"
        )]  # fmt: skip
        for one in self.parameters:
            span = "" if one.kind == "fixed" else f"{_number(one.low)} … {_number(one.high)}"
            parts = [half_width(sigma) for sigma in (one.sigma_noise, one.sigma_model)]
            rows.append((one.name, _number(one.value), span, *parts, one.unit, _number(one.given, ""), one.verdict))
        lines = [f"{self.name}: {self.model}, {self.estimator}", "", *_columns(rows), ""]
        lines += [
            f"{one.name}: {one.explanation}" for one in self.parameters if one.explanation and one.kind != "fixed"
        ]
        if self.channels:
            rows = [("log", "part", "channel", "fit %", "at most", "rms", "unit", "white p", "inputs p")]
            rows += [
                (one.log, one.part, one.channel, f"{one.nrmse_percent:.1f}", f"{one.noise_limit_percent:.0f}",
                 _number(one.rms), one.unit,
                 _number(one.whiteness_p, "", 2), _number(one.input_correlation_p, "", 2))
                for one in self.channels
            ]  # fmt: skip
            lines += ["", *_columns(rows)]
        for title, texts in (("Identified:", self.combinations), ("Advice:", self.advice), ("Notes:", self.notes)):
            lines += ["", title, *(f"  {text}" for text in texts)] if texts else []
        return "\n".join(lines)

    def save(self, folder: Path | str) -> Path:
        """Write fit.json, traces.parquet and profiles.parquet.

        Args:
            folder: is made if it does not exist.

        Returns:
            The folder.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        for name, frames, key in (("traces", self.traces, "log"), ("profiles", self.profiles, "parameter")):
            parts = [frame.assign(**{key: label}) for label, frame in frames.items()]
            table = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame({key: pd.Series(dtype=str)})
            write_file(folder / f"{name}.parquet", table.to_parquet(index=False))
        content: dict[str, Any] = {"mirdrake": FORMAT}
        for item in fields(self):
            if item.name not in {"traces", "profiles"}:
                content[item.name] = getattr(self, item.name)
        content["parameters"] = [asdict(one) for one in self.parameters]
        content["channels"] = [asdict(one) for one in self.channels]
        content["correlation"] = self.correlation.tolist()
        content["versions"] = dict(self.versions)
        text = json.dumps(_plain(content), indent=1, ensure_ascii=False, allow_nan=False)
        write_file(folder / "fit.json", (text + "\n").encode())
        return folder


def load_fit(folder: Path | str) -> Fit:
    """A fit that was saved.

    Raises:
        ConfigError: there is none, or it is of another format.
    """
    file = Path(folder) / "fit.json"
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        tables = {name: pd.read_parquet(file.parent / f"{name}.parquet") for name in ("traces", "profiles")}
    except OSError as error:
        raise ConfigError(f"{file}: no saved fit ({error.strerror or error}); run the study again") from None
    except ValueError as error:
        raise ConfigError(f"{file}: is damaged ({str(error).splitlines()[0]}); run the study again") from None
    if not isinstance(content, dict) or content.pop("mirdrake", None) != FORMAT:
        raise ConfigError(f"{file}: is not of format '{FORMAT}'; run the study again")
    try:
        content["parameters"] = tuple(FittedParameter(**one) for one in content["parameters"])
        content["channels"] = tuple(_channel_fit(one) for one in content["channels"])
        content["correlation"] = np.array(content["correlation"], dtype=np.float64).reshape(
            len(content["correlation"]), -1
        )
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
        raise ConfigError(f"{file}: is damaged ({error}); run the study again") from None


def _apart(table: pd.DataFrame, key: str) -> dict[str, pd.DataFrame]:
    found = {}
    for label, rows in table.groupby(key, sort=False):
        found[str(label)] = rows.drop(columns=key).dropna(axis="columns", how="all").reset_index(drop=True)
    return found


def _plain(value: Any) -> Any:
    """Numbers that JSON has: what is not finite becomes null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def half_width(sigma: float | None) -> str:
    """Of a 95 % interval, by a standard deviation; empty if there is none."""
    return _number(None if sigma is None else 1.96 * sigma, "", 2)


def _channel_fit(content: Mapping[str, Any]) -> ChannelFit:
    """As it was saved, where what is no number is none."""
    numbers = {name: math.nan for name in ("nrmse_percent", "noise_limit_percent", "rms") if content[name] is None}
    return ChannelFit(**{**content, **numbers})


def _number(value: float | None, none: str = "open", digits: int = 4) -> str:
    return none if value is None else f"{value:.{digits}g}"


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
