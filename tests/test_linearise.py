"""Linear models of diagrams between any two ports, against closed forms."""

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

import mirdrake as mir

pytest.importorskip("control")

FREQUENCIES = np.array([0.5, 2.0, 20.0])
T = 0.02


class Lag(LeafSystem):
    """x[k+1] = 0.8 x[k] + 0.4 u[k], y = x: a user's own system."""

    def __init__(self):
        super().__init__()
        self.u, state = self.DeclareVectorInputPort("u", 1), self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("y", state)
        self.DeclarePeriodicDiscreteUpdateEvent(T, 0.0, self._update)

    def _update(self, context, state):
        x = context.get_discrete_state(0).value()[0]
        state.set_value(0, [0.8 * x + 0.4 * self.u.Eval(context)[0]])


@pytest.fixture(scope="module")
def driven():
    d = mir.Diagram("empty", contact="point")
    ego = d.add_vehicle("bolt", speed=5.0)
    d.drive(ego, "constant", speed=5.0)
    lag = d.add("lag", Lag)
    d.connect(ego.vx, lag.u)
    return d, ego, lag


def test_a_system_of_the_user_has_its_transfer_function(driven):
    d, _, lag = driven
    model = d.linearize(lag.u, lag.y, time=0.1)
    z = np.exp(1j * FREQUENCIES * T)
    assert model.response(FREQUENCIES) == pytest.approx(0.4 / (z - 0.8), rel=1e-6)
    assert model.system.nstates == 1
    assert model.step(2.0).iloc[-1] == pytest.approx(2.0, rel=1e-6)  # 0.4 / (1 - 0.8)


def test_the_speed_pid_has_the_transfer_function_of_its_gains(driven):
    # kp = 1, ki = 1/s, integral by forward differences: -(kp + ki T / (z - 1)) from the measurement
    d, ego, _ = driven
    model = d.linearize(ego.control.speed_pid.measurement, ego.control.speed_pid.output, time=1.0)
    z = np.exp(1j * FREQUENCIES * T)
    assert model.response(FREQUENCIES) == pytest.approx(-(1.0 + T / (z - 1.0)), rel=1e-6)


def test_the_margins_of_the_speed_loop(driven):
    # The wheels follow fast, so the loop is near kp + ki / s: |L| = sqrt(1 + 1/w²) > 1 until the lag of the car, and
    # its sensitivity s / (2 s + 1) has no peak.
    d, ego, _ = driven
    model = d.linearize(ego.control.wheel_speeds.correction, time=2.0)
    assert model.output == "ego.control.speed_pid.output"
    assert np.abs(model.loop(np.array([0.1])))[0] == pytest.approx(np.hypot(1.0, 10.0), rel=0.01)
    margins = model.margins()
    assert margins.max_sensitivity == pytest.approx(1.0, abs=0.1)
    assert np.degrees(margins.phase_margin) > 60.0


def test_faults_are_one_line(driven):
    d, _, lag = driven
    for call, message in (
        (lambda: d.linearize("ego.contrl.x"), "unknown"),
        (lambda: d.linearize("ego.control.wheel_loops.setpoint"), "has 4 elements; name one of them: ego."),
        (lambda: d.linearize(lag.u, "ego.vz2", time=0.1), "unknown output 'ego.vz2'"),
        (lambda: d.linearize(lag.u, "ego.state", time=0.1), "output 'ego.state' has 12 elements; name one of them"),
    ):
        with pytest.raises(mir.MirdrakeError) as caught:
            call()
        assert message in str(caught.value)
        assert "\n" not in str(caught.value)


def test_operating_point_bode_and_root_locus(driven):
    import control

    d, _, lag = driven
    model = d.linearize(lag.u, lag.y, time=0.1)
    u, y = model.operating_point
    assert u == pytest.approx(5.0, abs=0.05)  # the speed of the vehicle
    assert 0.0 < y < 2.0 * u  # the lag has not reached its static gain of 2 yet
    # A proportional controller with gain k around 0.4 / (z - 0.8) has the pole 0.8 - 0.4 k.
    gains = [0.0, 1.0, 3.0]
    locus = control.root_locus_map(model.system, gains=gains)
    assert np.real(np.ravel(locus.loci)) == pytest.approx([0.8 - 0.4 * gain for gain in gains], abs=1e-6)
    magnitude, phase = (axes.lines[0].get_xydata() for axes in model.bode(lowest=1.0).axes)
    z = np.exp(1j * magnitude[:, 0] * T)
    assert magnitude[:, 1] == pytest.approx(np.abs(0.4 / (z - 0.8)), rel=1e-6)
    assert phase[0, 1] == pytest.approx(np.degrees(np.angle(0.4 / (z[0] - 0.8))), abs=1e-3)


def test_margins_equal_those_of_python_control(driven):
    import control

    d, ego, _ = driven
    model = d.linearize(ego.control.wheel_speeds.correction, time=2.0)
    frequencies = np.geomspace(0.01, 0.999 * np.pi / T, 20_000)
    measured = control.frd(model.loop(frequencies), frequencies)
    _, phase_margin, distance, _, crossover, _ = control.stability_margins(measured)
    margins = model.margins()
    assert np.degrees(margins.phase_margin) == pytest.approx(phase_margin, abs=0.1)
    assert margins.gain_crossover == pytest.approx(crossover, rel=1e-3)
    assert margins.max_sensitivity == pytest.approx(1.0 / distance, rel=1e-3)
