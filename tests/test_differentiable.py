"""The single-track model in JAX: states against the batch, gradients against differences."""

import numpy as np
import pytest

import mirdrake as mir
from mirdrake.batched.differentiable import make_drive
from mirdrake.core.errors import ConfigError, MissingDependencyError
from mirdrake.core.maths import choose
from mirdrake.single_track.parameters import PARAMETERS
from tests.batch_rigs import BRUSH, CAR, LINEAR, MAGIC, RICH, STEP, random_columns

try:
    import jax as jax_module  # here, because its import changes os.environ
except ImportError:
    jax_module = None

INSTALLED = jax_module is not None
needs_jax = pytest.mark.skipif(not INSTALLED, reason="JAX is not installed: pip install 'mirdrake[jax]'")


@pytest.fixture
def jax():
    jax_module.config.update("jax_enable_x64", True)
    return jax_module


def course(variant, times):
    """Return inputs: a slalom, drive and brakes."""
    t = np.arange(times) * STEP * 4
    inputs = np.zeros((times, len(variant.input_names)))
    inputs[:, 0], inputs[:, 1] = 0.03 * np.sin(2.0 * t), 2000.0 * np.cos(t)
    if variant.actuators:
        inputs[:, 4] = 20.0
    return inputs


def start_of(variant, speed=20.0):
    start = np.zeros(len(variant.state_names))
    start[variant.state_names.index("vx")] = speed
    return start


@needs_jax
@pytest.mark.slow
@pytest.mark.parametrize("variant", [LINEAR, BRUSH, RICH, MAGIC])
def test_the_states_are_those_of_a_batch(jax, variant):
    cars = mir.batch(CAR, variant, parameters=random_columns(5), step=STEP).reset(vx=20.0)
    parameters = np.array([list(record) for record in cars.parameters.tolist()])
    inputs = course(variant, 100)
    theirs = cars.run(inputs, hold=4).values[:, :, : len(variant.state_names)]
    drive = jax.vmap(make_drive(variant, step=STEP, hold=4), in_axes=(0, None, None))
    ours = np.asarray(drive(parameters, start_of(variant), inputs))
    assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-9 * float(np.abs(theirs).max()))


@needs_jax
@pytest.mark.slow
@pytest.mark.parametrize("name", ["mass", "front_stiffness", "front_friction", "yaw_inertia"])
def test_gradients_are_the_differences_of_a_batch(jax, name):
    inputs, base = course(BRUSH, 60), CAR.values()
    drive = make_drive(BRUSH, step=STEP, hold=4)
    column = PARAMETERS.index(name)
    gradient = jax.grad(lambda p: drive(p, start_of(BRUSH), inputs)[-1, 5])(jax.numpy.array(base))
    around = base[column] * np.array([1.0 - 1e-5, 1.0 + 1e-5])
    rates = mir.batch(CAR, BRUSH, parameters={name: around}, step=STEP).reset(vx=20.0).run(inputs, hold=4)["yaw_rate"]
    difference = (rates[1, -1] - rates[0, -1]) / (around[1] - around[0])
    assert float(gradient[column]) == pytest.approx(difference, rel=1e-5, abs=1e-12)


@needs_jax
@pytest.mark.slow
def test_gradients_by_the_steering(jax):
    inputs = course(BRUSH, 30)
    drive = make_drive(BRUSH, step=STEP, hold=4)
    gradient = jax.grad(lambda u: drive(jax.numpy.array(CAR.values()), start_of(BRUSH), u)[-1, 1])(inputs)
    moved = np.stack([inputs, inputs])
    moved[:, 10, 0] += [-1e-6, 1e-6]
    y = mir.batch(CAR, BRUSH, count=2, step=STEP).reset(vx=20.0).run(moved, hold=4)["y"][:, -1]
    assert float(gradient[10, 0]) == pytest.approx((y[1] - y[0]) / 2e-6, rel=1e-5)


@needs_jax
@pytest.mark.slow
def test_single_precision_is_an_error(jax):
    jax.config.update("jax_enable_x64", False)
    with pytest.raises(ConfigError, match="jax_enable_x64"):
        make_drive(BRUSH)


@pytest.mark.skipif(INSTALLED, reason="JAX is installed")
def test_without_jax_the_error_names_the_extra():
    with pytest.raises(MissingDependencyError, match=r"mirdrake\[jax\]"):
        make_drive(BRUSH)


@needs_jax
def test_values_are_chosen_element_by_element_of_arrays_of_jax(jax):
    given = jax.numpy.asarray([-1.0, 0.0, 2.0])
    assert jax.jit(lambda x: choose(x < 0.0, -x, x))(given).tolist() == [1.0, 0.0, 2.0]
