"""Compiled loop of the filters: square-root unscented Kalman filters of the single-track model.

The vector z of a filter has the states of the model without the pose; the steering angle δ and its rate; accelerations
that the model does not explain; and slow quantities: logarithms of factors on parameters, changes of parameters,
offsets of forces, biases of sensors. With n elements, mean m and lower triangular root S of the covariance, the sigma
points are m ± sqrt(N) S_j, all with the weight 1 / 2N, N = n (S. J. Julier and J. K. Uhlmann, Proc. IEEE 92, 2004, with
κ = 0; the same as the cubature points of I. Arasaratnam and S. Haykin, IEEE Trans. Automatic Control 54, 2009). As no
weight is negative, triangular factorisations replace all updates of Cholesky factors (R. van der Merwe and E. A. Wan,
ICASSP 2001; tria(A) is the lower triangular L with L Lᵀ = A Aᵀ)::

    prediction      S = tria [X, Q^½]                       X = (z_j - m) / sqrt(2N)
    update          [E 0; G S] = tria [Y R^½; X 0]          Y = (y_j - ŷ) / sqrt(2N)
                    e = E⁻¹ (y - ŷ),  m = m + G e,  log p(y) = -(eᵀe + k log 2π) / 2 - Σ log E_ii

The steering angle is measured with noise. As a mere input it would bias the parameters: the response to it would seem
too weak (errors in variables; T. Söderström, Errors-in-Variables Methods in System Identification, 2018, chapter 1). It
is therefore estimated, with an angular acceleration that is constant within a period and white from period to period,
another dimension of the sigma points of a prediction, N = n + 1 (Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation
with Applications to Tracking and Navigation, 2001, section 6.3.2).

The accelerations d along, across and about the vertical are first-order Gauss-Markov processes,
d(t + h) = exp(-h / T) d(t) + w. They act by half before and half after the Runge-Kutta steps of a period (splitting
after Strang, SIAM J. Numer. Anal. 5, 1968).

Noise. The variance R_i of a sensor is a moving average of its expectation given all measurements so far (online
expectation maximisation; O. Cappé, J. Comput. Graph. Statist. 20, 2011). The right one is a fixed point, E[e eᵀ] = 1::

    R_i ← R_i + γ R_i² ((E⁻ᵀ e)_i² - (E Eᵀ)⁻¹_ii)

Consistency. e is white with the covariance 1 if model and noise are right (R. K. Mehra, IEEE Trans. Automatic Control
15, 1970), and so are the changes of an element of z by the updates, u_j = (G e)_j / (G Gᵀ)_jj^½. Moving averages of
e_i² and of e_i ē_i are kept for each sensor; a bar denotes the weighted mean of past values, scaled to the variance 1.
If successive u_j have the same sign, the element follows too slowly, and its process noise is too small; if they
alternate, it is too large. The process noise of each acceleration and slow quantity is adapted until they are white::

    ln Q_j ← ln Q_j + γ_j u_j ū_j

A model that lacks an effect has errors that are functions of the motion. The u_j of the parameters are then correlated
over a manoeuvre, and Q_j grows until the interval of the parameter covers its apparent changes.

Each filter uses its own numbers only, and its operations have a fixed order.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mirdrake.batched.arrays import Floats, Integers
from mirdrake.batched.kernels import is_finite, moved, runge_kutta, write_motion, write_state
from mirdrake.core.compiled import Records
from mirdrake.core.maths import Value
from mirdrake.single_track.dynamics import (
    EQUATION_PARTS,
    Inputs,
    LateralForce,
    State,
    equations,
    read_state,
)

FACTOR, CHANGE, OFFSET, BIAS = range(4)
"""Effects of a slow quantity z: parameter · exp(z), parameter + z, input + z, measurement + z."""

STEERING, VX, VY, YAW_RATE, ROLL, ROLL_RATE, SIDESLIP, LONGITUDINAL, LATERAL = range(9)
"""Quantities that a sensor measures."""


class Design(NamedTuple):
    """What the filters of a group have in common.

    Attributes:
        positions: column in z of each field of :class:`State`; -1: zero.
        steering: column in z of steering angle and rate.
        accelerations: column in z of the accelerations along, across and about the vertical; -1: none.
        decays: exp(-h / T) of each element of z (n); 1 for states and random walks.
        effects: column in z, effect, and column of what it acts on (effects, 3).
        sensors: quantity of each sensor (k).
        ahead: its position ahead of the centre of mass (k) [m].
        rates: γ_j of each element of z and, last, of the acceleration of the steering (n + 1).
        forgetting: weight of the last value in ū_j and, last, in ē (n + 1).
        limits: least and largest variance over the initial one: of sensors, accelerations, slow quantities (3, 2).
        kinds: row of `limits` of each element of z and, last, of the acceleration of the steering (n + 1).
        gains: γ, the weight of a sample in the averages of the consistency, and the number of samples that the initial
            noise counts for.
    """

    positions: Integers
    steering: Integers
    accelerations: Integers
    decays: Floats
    effects: Integers
    sensors: Integers
    ahead: Floats
    rates: Floats
    forgetting: Floats
    limits: Floats
    kinds: Integers
    gains: Floats


class Memory(NamedTuple):
    """State of each of n filters.

    Attributes:
        mean: means of z (n, z).
        root: lower triangular roots of the covariances (n, z, z).
        process: variances of the process noise of a period and, last, of the acceleration of the steering (n, z + 1).
        noise: variances of the sensors (n, k).
        first_process: the same initially.
        first_noise: the same initially.
        inputs: last values of :class:`Inputs` (n, 5).
        recent: ē (n, k).
        changes: ū (n, z).
        squares: moving averages of their squares (n, k).
        products: moving averages of their products with ē (n, k).
        counts: number of updates, and number of measurements by sensor (n, 1 + k).
        diverged: 1 for a filter whose numbers are no longer finite (n).
    """

    mean: Floats
    root: Floats
    process: Floats
    noise: Floats
    first_process: Floats
    first_noise: Floats
    inputs: Floats
    recent: Floats
    changes: Floats
    squares: Floats
    products: Floats
    counts: Floats
    diverged: Integers


class Work(NamedTuple):
    """Buffers of a call.

    Attributes:
        points: sigma points (2 z + 2, z).
        seen: their measurements (2 z + 2, k).
        array: array to factorise (z + k, 3 z + k + 2).
        rows: sensors with a measurement (k).
        expected: mean of the measurements (k).
        vector: (z + k).
        second: (z + k).
    """

    points: Floats
    seen: Floats
    array: Floats
    rows: Integers
    expected: Floats
    vector: Floats
    second: Floats


def filter_over_time(
    law: LateralForce,
    flags: Records,
    design: Design,
    own: Floats,
    present: Floats,
    records: Records,
    inputs: Floats,
    measurements: Floats,
    step: float,
    steps: int,
    memory: Memory,
    first: int,
    last: int,
    means: Floats,
    variances: Floats,
    likelihoods: Floats,
    checks: Floats,
) -> None:
    """Run filters over samples.

    Args:
        law: lateral force of an axle.
        flags: one record of flags of the variant.
        design: what the filters have in common.
        own: parameters of each filter (n, p).
        present: a row for each filter that is overwritten (n, p).
        records: the same memory as records (n).
        inputs: values of :class:`Inputs` at the samples (1 or n, t, 5).
        measurements: measurements (1 or n, t, k); NaN for missing ones.
        step: step of the integration [s].
        steps: number of steps between two samples.
        memory: state of the filters, updated.
        first: first filter.
        last: filter after the last one.
        means: means of z after each sample (n, t, z), overwritten.
        variances: diagonals of the covariances (n, t, z), overwritten.
        likelihoods: log p(y) of each sample given the samples before (n, t), overwritten; -inf once diverged.
        checks: moving averages of the squares of the normalised innovations, and of the products of successive ones
            (n, t, 2, k), overwritten.
    """
    n, k = memory.mean.shape[1], memory.recent.shape[1]
    work = Work(
        np.empty((2 * n + 2, n)),
        np.empty((2 * n + 2, k)),
        np.zeros((n + k, 3 * n + k + 2)),
        np.empty(k, np.int64),
        np.empty(k),
        np.empty(n + k),
        np.empty(n + k),
    )
    for i in range(first, last):
        row, line = min(i, inputs.shape[0] - 1), min(i, measurements.shape[0] - 1)
        for t in range(inputs.shape[1]):
            if memory.diverged[i] == 0:
                if memory.counts[i, 0] > 0.0:
                    predict(
                        law, flags, design, own[i], present[i], records[i], inputs[row, t], step, steps, memory, i, work
                    )
                likelihoods[i, t] = update(
                    law,
                    flags,
                    design,
                    own[i],
                    present[i],
                    records[i],
                    inputs[row, t],
                    measurements[line, t],
                    memory,
                    i,
                    work,
                )
                memory.inputs[i] = inputs[row, t]
                memory.counts[i, 0] += 1.0
            if memory.diverged[i] != 0:
                likelihoods[i, t] = -np.inf
                means[i, t], variances[i, t], checks[i, t] = np.nan, np.nan, np.nan
                continue
            checks[i, t, 0], checks[i, t, 1] = memory.squares[i], memory.products[i]
            for j in range(n):
                means[i, t, j] = memory.mean[i, j]
                total = 0.0
                for m in range(j + 1):
                    total += memory.root[i, j, m] * memory.root[i, j, m]
                variances[i, t, j] = total


def predict(
    law: LateralForce,
    flags: Records,
    design: Design,
    own: Floats,
    present: Floats,
    record: Any,
    inputs: Floats,
    step: float,
    steps: int,
    memory: Memory,
    i: int,
    work: Work,
) -> None:
    """Predict a filter over a period; the inputs change linearly, which their mean represents."""
    n = memory.mean.shape[1]
    count, period = 2 * n + 2, step * steps
    mean, root, points = memory.mean[i], memory.root[i], work.points
    before, (angle, rate) = memory.inputs[i], (design.steering[0], design.steering[1])
    draw_points(mean, root, n + 1, points)
    points[count - 2], points[count - 1] = mean, mean
    acceleration = math.sqrt((n + 1) * memory.process[i, n])
    for j in range(count):
        z = points[j]
        extra = acceleration if j == count - 2 else -acceleration if j == count - 1 else 0.0
        u = Inputs(
            0.0,
            0.5 * (before[1] + inputs[1]),
            0.5 * (before[2] + inputs[2]),
            0.5 * (before[3] + inputs[3]),
            0.5 * (before[4] + inputs[4]),
        )
        u = apply_slow(design, own, present, z, u)
        kick = velocity_changes(design, z, 0.5 * period)
        x = moved(read_state(z, design.positions), 1.0, kick)
        for s in range(steps):
            # The steering angle in the middle of the step.
            time = (s + 0.5) * step
            steering = z[angle] + time * (z[rate] + 0.5 * time * extra)
            x = runge_kutta(law, flags[0], record, x, Inputs(steering, u.drive, u.brake, 0.0, 0.0), step)
        if not is_finite(x):
            memory.diverged[i] = 1
            return
        write_state(z, design.positions, moved(x, 1.0, kick))
        z[angle] += period * (z[rate] + 0.5 * period * extra)
        z[rate] += period * extra
        for m in range(n):
            z[m] *= design.decays[m]
    # Mean, and the array [X, Q^½].
    array = work.array
    centre(points, count, mean)
    scale = 1.0 / math.sqrt(1.0 * count)
    for m in range(n):
        for j in range(count):
            array[m, j] = scale * (points[j, m] - mean[m])
        for j in range(n):
            array[m, count + j] = 0.0
        array[m, count + m] = math.sqrt(memory.process[i, m])
    triangularise(array, n, count + n)
    for m in range(n):
        for j in range(n):
            root[m, j] = array[m, j] if j <= m else 0.0


# One passage over the arrays of `work`: its branches are loops over rows and columns, as compiled code should make no
# temporary arrays; its paragraphs are the equations of the update in the docstring of the module, in their order.
def update(
    law: LateralForce,
    flags: Records,
    design: Design,
    own: Floats,
    present: Floats,
    record: Any,
    inputs: Floats,
    measured: Floats,
    memory: Memory,
    i: int,
    work: Work,
) -> float:
    """Update a filter with a sample, and return the logarithm of its probability density."""
    n, sensors = memory.mean.shape[1], memory.recent.shape[1]
    count = 2 * n
    mean, root, points, seen = memory.mean[i], memory.root[i], work.points, work.seen
    k = 0
    for m in range(sensors):
        if math.isfinite(measured[m]):
            work.rows[k] = m
            k += 1
    if k == 0:
        return 0.0
    # Measurements of the sigma points.
    draw_points(mean, root, n, points)
    for j in range(count):
        z = points[j]
        u = apply_slow(design, own, present, z, Inputs(0.0, inputs[1], inputs[2], inputs[3], inputs[4]))
        u = Inputs(z[design.steering[0]], u.drive, u.brake, 0.0, 0.0)
        x = read_state(z, design.positions)
        rates, motion = equations(law, flags[0], record, x, u)
        push = velocity_changes(design, z, 1.0)
        for c in range(k):
            m = work.rows[c]
            if design.sensors[m] == STEERING:
                seen[j, c] = z[design.steering[0]]
            else:
                seen[j, c] = measure(
                    design.sensors[m], design.ahead[m], record, x, rates, push, motion[1] + push.vx, motion[2] + push.vy
                )
            for effect in design.effects:
                if effect[1] == BIAS and effect[2] == m:
                    seen[j, c] += z[effect[0]]
    # The array [Y R^½; X 0].
    array, expected = work.array, work.expected
    scale = 1.0 / math.sqrt(1.0 * count)
    for c in range(k):
        total = 0.0
        for j in range(count):
            total += seen[j, c]
        expected[c] = total / count
        for j in range(count):
            array[c, j] = scale * (seen[j, c] - expected[c])
        for b in range(k):
            array[c, count + b] = 0.0
        array[c, count + c] = math.sqrt(memory.noise[i, work.rows[c]])
    for m in range(n):
        for j in range(count):
            array[k + m, j] = scale * (points[j, m] - mean[m])
        for b in range(k):
            array[k + m, count + b] = 0.0
    triangularise(array, n + k, count + k)
    # Normalised innovations, likelihood, mean.
    e = work.vector
    likelihood = -0.5 * k * math.log(2.0 * math.pi)
    for c in range(k):
        total = measured[work.rows[c]] - expected[c]
        for b in range(c):
            total -= array[c, b] * e[b]
        e[c] = total / array[c, c]
        likelihood -= 0.5 * e[c] * e[c] + math.log(abs(array[c, c]))
    if not math.isfinite(likelihood):
        memory.diverged[i] = 1
        return -np.inf
    for m in range(n):
        for c in range(k):
            mean[m] += array[k + m, c] * e[c]
    adapt(design, memory, i, work, k)
    for m in range(n):
        for j in range(m + 1):
            root[m, j] = array[k + m, k + j]
    return likelihood


def adapt(design: Design, memory: Memory, i: int, work: Work, k: int) -> None:
    """Adapt the noise, and update the averages of the consistency, by normalised innovations."""
    n, array, e, column = memory.mean.shape[1], work.array, work.vector, work.second
    # A moving average that begins with the initial noise, which counts for some samples.
    rate = max(design.gains[0], 1.0 / (design.gains[2] + memory.counts[i, 0])) if design.gains[0] > 0.0 else 0.0
    # The first sample has the initial errors of the states.
    if rate > 0.0 and memory.counts[i, 0] > 0.0:
        # Columns of E⁻¹ by forward substitution: (E⁻ᵀ e)_c = column · e, (E Eᵀ)⁻¹_cc = column · column.
        for c in range(k):
            pull, share = 0.0, 0.0
            for b in range(c, k):
                total = 1.0 if b == c else 0.0
                for a in range(c, b):
                    total -= array[b, a] * column[a]
                column[b] = total / array[b, b]
                pull += column[b] * e[b]
                share += column[b] * column[b]
            m = work.rows[c]
            # More than three standard deviations are an outlier, or a motion that the filter does not follow yet.
            excess = min(pull * pull, 9.0 * share) - share
            memory.noise[i, m] = limit(
                memory.noise[i, m] * (1.0 + rate * memory.noise[i, m] * excess),
                memory.first_noise[i, m],
                design.limits[0],
            )
    for j in range(n + 1):
        # The acceleration of the steering acts on its rate.
        row = j if j < n else design.steering[1]
        if design.rates[j] > 0.0:
            pull, share = 0.0, 0.0
            for c in range(k):
                pull += array[k + row, c] * e[c]
                share += array[k + row, c] * array[k + row, c]
            if share > 0.0:
                change = pull / math.sqrt(share)
                # A product far from its standard deviation of 1 is an outlier.
                product = min(max(change * memory.changes[i, row], -3.0), 3.0)
                memory.process[i, j] = limit(
                    memory.process[i, j] * math.exp(design.rates[j] * product),
                    memory.first_process[i, j],
                    design.limits[design.kinds[j]],
                )
                keep = 1.0 - design.forgetting[row]
                if j < n or design.rates[row] == 0.0:
                    memory.changes[i, row] = keep * memory.changes[i, row] + math.sqrt(1.0 - keep * keep) * change
    keep = 1.0 - design.forgetting[n]
    for c in range(k):
        m = work.rows[c]
        memory.counts[i, 1 + m] += 1.0
        weight = max(design.gains[1], 1.0 / memory.counts[i, 1 + m])
        memory.squares[i, m] += weight * (e[c] * e[c] - memory.squares[i, m])
        memory.products[i, m] += weight * (e[c] * memory.recent[i, m] - memory.products[i, m])
        memory.recent[i, m] = keep * memory.recent[i, m] + math.sqrt(1.0 - keep * keep) * e[c]


def limit(variance: float, first: float, limits: Sequence[float]) -> float:
    """Return a variance within its limits, which are relative to the first one."""
    return min(max(variance, limits[0] * first), limits[1] * first)


def draw_points(mean: Floats, root: Floats, dimensions: int, points: Floats) -> None:
    """Write the sigma points of a mean and a root in `dimensions`, of which those of the mean are the first."""
    n = len(mean)
    spread = math.sqrt(1.0 * dimensions)
    for j in range(n):
        for m in range(n):
            points[2 * j, m] = mean[m] + spread * root[m, j]
            points[2 * j + 1, m] = mean[m] - spread * root[m, j]


def centre(points: Floats, count: int, mean: Floats) -> None:
    """Write the mean of the first `count` sigma points."""
    for m in range(len(mean)):
        total = 0.0
        for j in range(count):
            total += points[j, m]
        mean[m] = total / count


def apply_slow(design: Design, own: Floats, present: Floats, z: Floats, u: Inputs) -> Inputs:
    """Write the parameters of a sigma point, and return its inputs."""
    drive, brake = u.drive, u.brake
    for m in range(len(own)):
        present[m] = own[m]
    for effect in design.effects:
        value, column = z[effect[0]], effect[2]
        if effect[1] == FACTOR:
            present[column] *= math.exp(value)
        elif effect[1] == CHANGE:
            present[column] += value
        elif effect[1] == OFFSET:
            drive += value if column == 1 else 0.0
            brake += value if column == 2 else 0.0
    return Inputs(u.steering, drive, brake, u.steering_rate, u.speed)


def velocity_changes(design: Design, z: Floats, time: float) -> State:
    """Return the changes of the velocities during a time [s], from the accelerations of a sigma point."""
    along, across, about = design.accelerations[0], design.accelerations[1], design.accelerations[2]
    return State(
        0.0,
        0.0,
        0.0,
        time * z[along] if along >= 0 else 0.0,
        time * z[across] if across >= 0 else 0.0,
        time * z[about] if about >= 0 else 0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    )


def measure(
    quantity: int,
    ahead: float,
    p: Any,
    x: State,
    rates: State,
    push: State,
    longitudinal: float,
    lateral: float,
) -> Value:
    """Return what a sensor measures; an accelerometer measures acceleration less gravity.

    Args:
        quantity: quantity of the sensor.
        ahead: its position ahead of the centre of mass [m].
        p: parameters by name; gravity in the frame of the vehicle.
        x: states.
        rates: their derivatives by the equations.
        push: accelerations that the equations do not explain.
        longitudinal: longitudinal acceleration of the centre of mass [m/s²].
        lateral: lateral acceleration of the centre of mass [m/s²].
    """
    if quantity == VX:
        return x.vx
    if quantity == VY:
        return x.vy + ahead * x.yaw_rate
    if quantity == YAW_RATE:
        return x.yaw_rate
    if quantity == ROLL:
        return x.roll
    if quantity == ROLL_RATE:
        return x.roll_rate
    if quantity == SIDESLIP:
        return math.atan((x.vy + ahead * x.yaw_rate) / max(abs(x.vx), p.blend_start))
    if quantity == LONGITUDINAL:
        return longitudinal - ahead * x.yaw_rate * x.yaw_rate - p.gravity_x
    # A body that rolls to the right lifts the left axis of the sensor, which then measures part of gravity.
    return lateral + ahead * (rates.yaw_rate + push.yaw_rate) - p.gravity_y - p.gravity_z * x.roll


def triangularise(a: Floats, rows: int, columns: int) -> None:
    """Overwrite the lower triangle of an array A with that of L, L Lᵀ = A Aᵀ, L_ii ≥ 0; `columns` ≥ `rows`.

    Householder reflections from the right (G. H. Golub and C. F. Van Loan, Matrix Computations, 4th ed., section 5.2).
    """
    for i in range(rows):
        norm = 0.0
        for j in range(i, columns):
            norm += a[i, j] * a[i, j]
        norm = math.sqrt(norm)
        if norm == 0.0:
            continue
        # The reflection takes the row to ±norm; the sign avoids cancellation.
        alpha = -norm if a[i, i] > 0.0 else norm
        a[i, i] -= alpha
        size = 0.0
        for j in range(i, columns):
            size += a[i, j] * a[i, j]
        for m in range(i + 1, rows):
            total = 0.0
            for j in range(i, columns):
                total += a[m, j] * a[i, j]
            total *= 2.0 / size
            for j in range(i, columns):
                a[m, j] -= total * a[i, j]
        a[i, i] = alpha
    # Signs of columns are free; a positive diagonal makes the root unique.
    for i in range(rows):
        if a[i, i] < 0.0:
            for m in range(i, rows):
                a[m, i] = -a[m, i]


FILTER_PARTS = (
    *EQUATION_PARTS,
    equations,
    runge_kutta,
    moved,
    is_finite,
    write_state,
    write_motion,
    predict,
    update,
    adapt,
    limit,
    draw_points,
    centre,
    apply_slow,
    velocity_changes,
    measure,
    triangularise,
)
"""Functions that the loop calls."""
