"""Effective axle stiffnesses of the multi-body cars of commonroad-vehicle-models, in closed form.

The understeer budget (W. F. and D. L. Milliken, Race Car Vehicle Dynamics, 1995, sections 5 and 7; T. D. Gillespie,
Fundamentals of Vehicle Dynamics, 1992, chapter 6) from the package's published parameters, without its equations of
motion. In a slow turn of lateral acceleration ay the roll angle of the body is φ about an axis on the road, where
the package has its roll centres, and the camber of the wheels is a part of it::

    φ = ms h ay / (Kf + Kr - ms g h)        γ = (1 + D T Δφ / 2 φ) φ

with K springs and bar of an axle in series with its tyres. The axle has to bring F = m ay b / L (front), a for b at the
rear; its tyres, loaded with N = g (ms b / L + mu), do so at the slip α that the Magic Formula has for this camber::

    F / N = D sin(C atan(x - E (x - atan x))) - SV,    x = K (α + SH) / (C D)

SH and SV are camber thrust and, in the package, ply-steer: all of them push the car into the turn. The force is
proportional to the load; load transfer has therefore no effect, and the lateral compliance of the axles is not slip.
F / α is the effective stiffness; it decreases with ay since ply-steer is a constant and since tyres saturate. The
stiffness of a drive is the slope of the straight line through the origin that fits F over α best at the accelerations
of its samples.
"""

from typing import Any

import numpy as np
from scipy.optimize import brentq

from tests.commonroad_car import camber_by_roll
from tests.commonroad_rig import GRAVITY, Array


def roll_gain(p: Any) -> float:
    """Return the roll angle over lateral acceleration [rad s²/m]."""
    stiffness = 0.0
    for track, spring, bar in ((p.T_f, p.K_sf, p.K_tsf), (p.T_r, p.K_sr, p.K_tsr)):
        springs, tyres = 0.5 * spring * track**2 - bar, 0.5 * p.K_zt * track**2
        stiffness += springs * tyres / (springs + tyres)
    return float(p.m_s * p.h_s / (stiffness - p.m_s * GRAVITY * p.h_s))


def axle_loads(p: Any) -> tuple[float, float]:
    """Return the static load of the front and rear axle [N]."""
    length = p.a + p.b
    return GRAVITY * (p.m_s * p.b / length + p.m_uf), GRAVITY * (p.m_s * p.a / length + p.m_ur)


def tyre_stiffnesses(p: Any) -> tuple[float, float]:
    """Return the cornering stiffness of the bare tyres of each axle [N/rad]."""
    front, rear = axle_loads(p)
    return -p.tire.p_ky1 * front, -p.tire.p_ky1 * rear


def _slip(p: Any, force_ratio: float, camber: float) -> float:
    """Return the slip angle [rad] of a tyre for a lateral force over load [1]; camber [rad] is to the outside."""
    t = p.tire
    side = np.sign(camber)
    shift, push = side * t.p_hy1 + t.p_hy3 * camber, side * t.p_vy1 + t.p_vy3 * camber
    peak = t.p_dy1 * (1.0 - t.p_dy3 * camber**2)

    def missing(slip: float) -> float:
        x = -t.p_ky1 / (t.p_cy1 * peak) * (slip + shift)
        return float(peak * np.sin(t.p_cy1 * np.arctan(x - t.p_ey1 * (x - np.arctan(x)))) - push - force_ratio)

    return float(brentq(missing, -0.2, 0.5))


def effective_stiffnesses(p: Any, accelerations: Array) -> tuple[float, float]:
    """Return the effective stiffness of front and rear axle in a drive [N/rad].

    Args:
        p: parameters of a car.
        accelerations: lateral ones, of the samples [m/s²].
    """
    length, gain, stiffnesses = p.a + p.b, roll_gain(p), []
    grid = np.linspace(0.01, 6.0, 200)
    for arm, load, camber_per_roll in zip((p.b, p.a), axle_loads(p), camber_by_roll(p), strict=True):
        forces = p.m * grid * arm / length
        slips = [_slip(p, force / load, camber_per_roll * gain * ay) for force, ay in zip(forces, grid, strict=True)]
        size = np.abs(accelerations)
        force, slip = np.interp(size, grid, forces), np.interp(size, grid, slips)
        stiffnesses.append(float(force @ slip / (slip @ slip)))
    return stiffnesses[0], stiffnesses[1]
