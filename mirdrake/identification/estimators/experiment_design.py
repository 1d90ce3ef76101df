"""Experiment design: which manoeuvre would reduce the uncertainty most, by the Fisher information of the model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mirdrake.identification.estimators.problem import Problem
from mirdrake.identification.estimators.shooting import make_shots, simulate
from mirdrake.identification.models.base import Model, Segment
from mirdrake.identification.models.manoeuvres import STEP
from mirdrake.identification.parameters import FitParameter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Candidate:
    """Manoeuvre and the expected uncertainty after it.

    Attributes:
        name: name of the manoeuvre.
        sigmas: predicted standard deviations of the scaled free parameters, with the present information (p).
        d_gain: factor on the standard deviations, geometric mean over the uncertainty ellipsoid [1].
        a_gain: factor on the root of the mean variance [1].
    """

    name: str
    sigmas: Array
    d_gain: float
    a_gain: float


def rank_manoeuvres(
    model: Model,
    unknowns: Sequence[FitParameter],
    values: Mapping[str, float],
    sigmas: Mapping[str, float],
    *,
    known: Array | None = None,
    speed: float = 20.0,
) -> tuple[Candidate, ...]:
    """Return manoeuvres that the model can follow, the best first, by D-optimality.

    Args:
        model: the model.
        unknowns: its parameters; the free ones count.
        values: values of the parameters.
        sigmas: noise by output.
        known: present information (p, p); None for weak priors only.
        speed: highest speed that may be driven [m/s].
    """
    free = [unknown for unknown in unknowns if unknown.kind != "fixed"]
    base = np.diag([1.0 / parameter.info.usual**2 if parameter.info.usual > 0.0 else 1e-6 for parameter in free])
    # The small term keeps the inverse finite along directions without any information.
    now = base if known is None else known + 1e-9 * np.eye(len(free))
    before = np.linalg.inv(now)
    ranking = []
    plans = model.candidate_manoeuvres(values, speed)
    for name, drive in zip(plans, _driven(model, values, list(plans.values())), strict=True):
        is_driven = all(np.isfinite(channel).all() for channel in drive.outputs.values())
        gained = information(model, unknowns, values, sigmas, drive) if is_driven else np.full_like(now, np.nan)
        if not np.isfinite(gained).all():
            continue
        after = np.linalg.inv(now + gained)
        # D-optimality: the volume of the ellipsoid, as a logarithm, since the determinant would underflow.
        signs = [np.linalg.slogdet(matrix)[1] for matrix in (before, after)]
        ranking.append(
            Candidate(
                name, np.sqrt(np.diag(after)), float(np.exp(0.5 * (signs[1] - signs[0]) / len(free))),
                float(np.sqrt(np.trace(after) / np.trace(before))),
            )
        )  # fmt: skip
    return tuple(sorted(ranking, key=lambda candidate: candidate.d_gain))


def information(
    model: Model,
    unknowns: Sequence[FitParameter],
    values: Mapping[str, float],
    sigmas: Mapping[str, float],
    drive: Segment,
) -> Array:
    """Return the Fisher information of the scaled free parameters, offsets and initial states eliminated (p, p)."""
    problem = Problem(model, [drive], unknowns, sigmas)
    jacobian = problem.jacobian(problem.scaled(values))
    p = len(problem.free)
    data, rest = jacobian[: problem.measured], jacobian[problem.measured :, p:]
    inside = data.T @ data
    # Schur complement with the priors: a manoeuvre must determine the parameters beside unknown offsets and states.
    inside[p:, p:] += rest.T @ rest
    return np.asarray(inside[:p, :p] - inside[:p, p:] @ np.linalg.solve(inside[p:, p:], inside[p:, :p]))


def _driven(model: Model, values: Mapping[str, float], plans: Sequence[Mapping[str, Array]]) -> list[Segment]:
    """Return segments with simulated outputs, so that the initial guesses of the states are close."""
    drives = []
    for channels in plans:
        many = len(next(iter(channels.values())))
        inputs = {name: channels[name] for name in model.inputs}
        outputs = {name: channels.get(name, np.zeros(many)) for name in model.outputs}
        drive = Segment("plan", "train", 0.0, STEP, inputs, outputs)
        first = model.initial_states(values, drive, np.zeros(1, dtype=np.intp))[:, 0]
        run = simulate(model, make_shots(model, drive, values), [values], first, derivatives=False)
        seen = np.full((len(model.outputs), many), np.nan) if run is None else run.y
        drives.append(replace(drive, outputs=dict(zip(model.outputs, seen, strict=True))))
    return drives
