"""Tuning rules: gains of a PID controller from a simple model, or from the ultimate point.

Rules give the standard form K, Ti, Td (SIMC the series form), which :mod:`mirdrake.tuning.gains` converts to kp, ki,
kd. Symbols: K static gain of the model, T time constant, L dead time; Kv gain of an integrator; Ku, Tu ultimate gain
and period.

Sources:

- Ziegler-Nichols: J. G. Ziegler and N. B. Nichols, Optimum settings for automatic controllers, Trans. ASME 64 (1942);
  the tables of Åström and Hägglund, Advanced PID Control (2006), section 6.2.
- SIMC: S. Skogestad, J. Process Control 13 (2003) 291.
- AMIGO: K. J. Åström and T. Hägglund, Revisiting the Ziegler-Nichols step response method for PID control,
  J. Process Control 14 (2004) 635; Advanced PID Control, section 7.
- Lambda: E. B. Dahlin (1968); Åström and Hägglund, section 6.5. Integrator: I.-L. Chien and P. S. Fruehauf, Chem. Eng.
  Progress 86 (1990).
"""

from typing import Literal

from mirdrake.core.checks import check_number
from mirdrake.core.errors import ConfigError, did_you_mean
from mirdrake.core.pid import PidGains
from mirdrake.tuning.gains import from_series, from_standard
from mirdrake.tuning.models import FirstOrder, Integrator

Form = Literal["P", "PI", "PID"]


def ziegler_nichols_step(model: FirstOrder | Integrator, form: Form = "PI") -> PidGains:
    """Return gains by the step response rule of Ziegler and Nichols, with a = K L / T (a = Kv L).

    P: 1/a; PI: 0.9/a, 3 L; PID: 1.2/a, 2 L, L/2. The rule aims at quarter amplitude damping; Ms is 2 or more.

    Raises:
        ConfigError: no dead time, or an unknown form.
    """
    # The rule needs the slope of the response only: K / T for a first order, Kv for an integrator.
    slope = model.gain if isinstance(model, Integrator) else model.gain / model.time_constant
    delay = _delay(model)
    a = slope * delay
    match form:
        case "P":
            return from_standard(1.0 / a)
        case "PI":
            return from_standard(0.9 / a, 3.0 * delay)
        case "PID":
            return from_standard(1.2 / a, 2.0 * delay, 0.5 * delay)
    raise _unknown(form, "P", "PI", "PID")


def ziegler_nichols_ultimate(ultimate_gain: float, ultimate_period: float, form: Form = "PI") -> PidGains:
    """Return gains by the frequency response rule of Ziegler and Nichols.

    P: 0.5 Ku; PI: 0.45 Ku, Tu/1.2; PID: 0.6 Ku, Tu/2, Tu/8.

    Args:
        ultimate_gain: Ku [u/y].
        ultimate_period: Tu [s].
        form: of the controller.

    Raises:
        ConfigError: the period is not positive, or an unknown form.
    """
    gain, period = _ultimate(ultimate_gain, ultimate_period)
    match form:
        case "P":
            return from_standard(0.5 * gain)
        case "PI":
            return from_standard(0.45 * gain, period / 1.2)
        case "PID":
            return from_standard(0.6 * gain, period / 2.0, period / 8.0)
    raise _unknown(form, "P", "PI", "PID")


def simc(model: FirstOrder | Integrator, *, closed_loop_time: float | None = None) -> PidGains:
    """Return PI gains by Skogestad's SIMC rule: Kc = T / (K (τc + L)), τI = min(T, 4 (τc + L)).

    Args:
        model: the model.
        closed_loop_time: desired time constant τc [s]; None: the dead time, as the rule recommends.

    Raises:
        ConfigError: neither dead time nor `closed_loop_time`.
    """
    time = _delay(model) if closed_loop_time is None else closed_loop_time
    total = check_number("SIMC", "closed_loop_time", time, unit="s", above=-model.delay) + model.delay
    if isinstance(model, Integrator):
        return from_series(1.0 / (model.gain * total), 4.0 * total)
    lag = model.time_constant
    return from_series(lag / (model.gain * total), min(lag, 4.0 * total))


def simc_double_integrator(gain: float, delay: float, *, closed_loop_time: float | None = None) -> PidGains:
    """Return SIMC for ``gain exp(-delay s) / s²``: series PID, Kc = 1/(4 gain (τc + L)²), τI = τD = 4 (τc + L).

    Args:
        gain: acceleration gain [y/(u s²)].
        delay: dead time L [s].
        closed_loop_time: τc [s]; None: the dead time.
    """
    time = delay if closed_loop_time is None else closed_loop_time
    total = check_number("SIMC", "closed_loop_time + delay", time + delay, unit="s", above=0.0)
    return from_series(1.0 / (4.0 * gain * total**2), 4.0 * total, 4.0 * total)


def amigo(model: FirstOrder | Integrator, form: Form = "PI") -> PidGains:
    """Return gains by the AMIGO rule, a fit to robust loop shaping (M = 1.4) of a set of monotone processes.

    PI: K Kp = 0.15 + (0.35 - L T/(L+T)²) T/L, Ti = 0.35 L + 13 L T²/(T² + 12 L T + 7 L²);
    PID: K Kp = 0.2 + 0.45 T/L, Ti = L (0.4 L + 0.8 T)/(L + 0.1 T), Td = 0.5 L T/(0.3 L + T).
    Integrator, the limit for large T: PI 0.35/(Kv L), 13.35 L; PID 0.45/(Kv L), 8 L, 0.5 L.
    Set-point weight of PID: b = 0 for L < T (lag dominated), else 1, as in the paper.

    Raises:
        ConfigError: no dead time, or an unknown form.
    """
    delay = _delay(model)
    if form not in ("PI", "PID"):
        raise _unknown(form, "PI", "PID")
    # A process that integrates has no lag and its own table of the rule.
    if isinstance(model, Integrator):
        if form == "PI":
            return from_standard(0.35 / (model.gain * delay), 13.35 * delay)
        return from_standard(0.45 / (model.gain * delay), 8.0 * delay, 0.5 * delay, proportional_weight=0.0)
    lag = model.time_constant
    if form == "PI":
        gain = 0.15 + (0.35 - delay * lag / (delay + lag) ** 2) * lag / delay
        integral = 0.35 * delay + 13.0 * delay * lag**2 / (lag**2 + 12.0 * delay * lag + 7.0 * delay**2)
        return from_standard(gain / model.gain, integral)
    gain = 0.2 + 0.45 * lag / delay
    integral = delay * (0.4 * delay + 0.8 * lag) / (delay + 0.1 * lag)
    derivative = 0.5 * delay * lag / (0.3 * delay + lag)
    # Processes in which the lag is longer than the delay overshoot after a step of the set-point; it acts through the
    # integral part only.
    weight = 0.0 if delay < lag else 1.0
    return from_standard(gain / model.gain, integral, derivative, proportional_weight=weight)


def lambda_tuning(model: FirstOrder | Integrator, closed_loop_time: float) -> PidGains:
    """Return gains for a closed loop of first order (critically damped for an integrator) with a time constant λ.

    PI: T/(K (λ + L)), T; integrator: (2 λ + L)/(Kv (λ + L)²), 2 λ + L.

    Args:
        model: the model.
        closed_loop_time: λ [s].

    Raises:
        ConfigError: λ + L is not positive.
    """
    # λ is the time constant that the closed loop shall have; the gains cancel the lag of the process.
    time = check_number("lambda tuning", "closed_loop_time", closed_loop_time, unit="s", at_least=0.0)
    delay = model.delay
    check_number("lambda tuning", "closed_loop_time + delay", time + delay, unit="s", above=0.0)
    if isinstance(model, Integrator):
        return from_standard((2.0 * time + delay) / (model.gain * (time + delay) ** 2), 2.0 * time + delay)
    return from_standard(model.time_constant / (model.gain * (time + delay)), model.time_constant)


def _delay(model: FirstOrder | Integrator) -> float:
    if model.delay <= 0.0:
        raise ConfigError(
            f"{type(model).__name__}: the rule needs a dead time; set closed_loop_time, or use lambda tuning"
        )
    return model.delay


def _ultimate(gain: float, period: float) -> tuple[float, float]:
    return (
        check_number("ultimate point", "gain", gain),
        check_number("ultimate point", "period", period, unit="s", above=0.0),
    )


def _unknown(form: object, *allowed: str) -> ConfigError:
    return ConfigError(f"no rule for {form!r}; {did_you_mean(form, allowed)}")
