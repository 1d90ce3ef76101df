"""A textbook loop with the interface of vehicle loops, which can be sent to worker processes; a short study."""

import os
import signal
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mirdrake.core.pid import PidGains
from mirdrake.tuning import (
    LinearProcess,
    TransferFunction,
    controller_response,
    is_stable,
    response_figures,
    simulate_loop,
)
from mirdrake.tuning.loops.base import NOMINAL, Conditions, Evaluation, Fidelity

PERIOD, STEPS = 0.05, 160


def short_study(**changes: Any) -> dict[str, Any]:
    """Return a study of the Bolt's speed loop that takes seconds, with other entries where they are given."""
    return {
        "vehicle": "bolt",
        "loop": "speed",
        "baseline": "published",
        "test": {"duration": 4.0, "load_time": 3.5, "step": 1.0},
        "search": {"trials": 8, "confirm": 1},
        "constraints": {"overshoot_percent": 20, "ms": 1.8},
        "robustness": {"runs": 0},
        **changes,
    }


@dataclass(frozen=True)
class TextbookLoop:
    """A first-order plant with dead time under PI control: a step of the set-point.

    Mass scales the time constant, friction the gain; delay adds to the dead time, grade and noise to the control.

    Attributes:
        time_constant: [s].
        dead_time: [s].
        fault: what happens for kp above 4: "kill" of the process, "hang", or "raise".
        count: a file that gets a byte an evaluation.
    """

    time_constant: float = 1.0
    dead_time: float = 0.2
    fault: str = ""
    count: str = ""

    def __call__(
        self, gains: Mapping[str, float], conditions: Conditions = NOMINAL, fidelity: Fidelity = "plant"
    ) -> Evaluation:
        if self.count:
            with Path(self.count).open("ab") as file:
                file.write(b".")
        if self.fault and gains["kp"] > 4.0:
            if self.fault == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            while self.fault == "hang":
                time.sleep(0.1)
            raise ValueError("kp is too large")
        gain = 1.0 if conditions.friction is None else conditions.friction
        dead_time = self.dead_time + (conditions.delay or 0.0)
        plant = TransferFunction((gain,), (self.time_constant * conditions.mass, 1.0), dead_time)
        pid = PidGains(gains["kp"], gains.get("ki", 0.0))
        if not is_stable(plant, pid):
            return Evaluation("unstable", reason="a pole in the right half plane")
        load = conditions.grade + conditions.noise * np.random.default_rng(conditions.seed).standard_normal(STEPS)
        response = simulate_loop(
            LinearProcess(plant, PERIOD), pid, period=PERIOD, reference=np.ones(STEPS), disturbance=load
        )
        if len(response.time) < STEPS:
            return Evaluation("unstable", reason="it left all bounds")
        figures = response_figures(response.time, response.reference, response.measurement, response.control)
        omega = np.geomspace(1e-2, 1e2, 400)
        loop = controller_response(pid, omega) * plant.response(omega)
        return Evaluation(
            "ok",
            {
                "iae": figures.iae,
                "total_variation": figures.total_variation,
                "overshoot_percent": 100.0 * figures.overshoot,
                "settling_time": figures.settling_time,
                "steady_error": figures.steady_error,
                "ms": float(np.max(1.0 / np.abs(1.0 + loop))),
            },
        )
