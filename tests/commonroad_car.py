"""A vehicle folder with the parameters of commonroad-vehicle-models, and simulations of our models with it."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Adder, LogVectorOutput

from mirdrake.plant.plant import PlantSpec, make_plant, set_start
from mirdrake.plant.suspension import make_axle_forces
from mirdrake.single_track import SingleTrack, estimate_parameters
from mirdrake.single_track.dynamics import Variant
from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters
from mirdrake.vehicles import Vehicle
from mirdrake.worlds import load_world
from tests.commonroad_rig import GRAVITY, SAMPLE, SPEED, Array, Manoeuvre, Reference, Trace
from tests.rigs import add_tyres
from tests.tir_files import write_tir

LINEAR_LOAD = 1e4
"""PKY2: with it sin(2 atan(load / (PKY2 FNOMIN))) is a straight line; the package has cornering stiffness over load."""

STIFF = 1e9
"""Stiffness of a practically rigid carcass [N/m]."""


def tyre(p: Any, *, camber: float = 1.0, lateral: float = STIFF) -> MagicFormulaParameters:
    """Return the package's tyre as Magic Formula 6.1; where PAC2002 writes PHY3, it has PKY6.

    PDY1 is negative in .tir files, so what is multiplied by it, RVY1 and RVY3, changes its sign, too. The shifts PHX1,
    PVX1, PHY1 and PVY1 are left out, see the head of :mod:`tests.commonroad_rig`.

    Args:
        p: parameters of a car.
        camber: factor on the coefficients of camber.
        lateral: stiffness to the side that makes the relaxation length [N/m].
    """
    t = p.tire
    nominal = 0.25 * p.m * GRAVITY
    return MagicFormulaParameters(
        version="6.1",
        unloaded_radius=p.R_w,
        fnomin=nominal,
        longitudinal_stiffness=t.p_kx1 * nominal / 0.02,  # a relaxation length of 20 mm: none in the package
        lateral_stiffness=lateral,
        pcx1=t.p_cx1, pdx1=t.p_dx1, pdx3=t.p_dx3, pex1=t.p_ex1, pkx1=t.p_kx1,
        rbx1=t.r_bx1, rbx2=t.r_bx2, rcx1=t.r_cx1, rex1=t.r_ex1, rhx1=t.r_hx1,
        pcy1=t.p_cy1, pdy1=-t.p_dy1, pdy3=t.p_dy3, pey1=t.p_ey1,
        pky1=0.5 * LINEAR_LOAD * t.p_ky1, pky2=LINEAR_LOAD, pky6=camber * (t.p_hy3 * t.p_ky1 + t.p_vy3),
        pvy3=camber * t.p_vy3,
        rby1=t.r_by1, rby2=t.r_by2, rby3=t.r_by3, rcy1=t.r_cy1, rey1=t.r_ey1, rhy1=t.r_hy1,
        rvy1=-t.r_vy1, rvy3=-t.r_vy3, rvy4=t.r_vy4, rvy5=t.r_vy5, rvy6=t.r_vy6,
    )  # fmt: skip


def load_ratios(p: Any) -> tuple[float, float]:
    """Load of the front and the rear axle in the package, over that of a car with its whole mass at the same place."""
    length = p.a + p.b
    return (
        (p.m_s * p.b / length + p.m_uf) / (p.m * p.b / length),
        (p.m_s * p.a / length + p.m_ur) / (p.m * p.a / length),
    )


def camber_by_roll(p: Any) -> tuple[float, float]:
    """Camber of front and rear wheels in the package when the body rolls slowly, over the roll angle of the body [1].

    With D as change of camber by travel it is 1 + D T Δφ / (2 φ), where Δφ is the roll of the body against the axle:
    roll stiffness of springs and bar and that of the tyres are in series.
    """
    camber_gains = []
    for gain, track, spring, bar in ((p.D_f, p.T_f, p.K_sf, p.K_tsf), (p.D_r, p.T_r, p.K_sr, p.K_tsr)):
        springs, tyres = 0.5 * spring * track**2 - bar, 0.5 * p.K_zt * track**2
        camber_gains.append(1.0 + 0.5 * gain * track * tyres / (tyres + springs))
    return camber_gains[0], camber_gains[1]


def centre_of_sprung_mass(p: Any) -> tuple[float, float]:
    """Return x and z of the reference's centre of sprung mass in the frame of our car [m].

    The origin is below the rear axle. The height is over the road at standstill, with the tyres deflected by their load
    over their stiffness.
    """
    length = p.a + p.b
    return p.b, p.h_s + p.m * GRAVITY * 2.0 * p.a * p.b / length**2 / (2.0 * p.K_zt)


def write_car(folder: Path, p: Any, *, kind: Reference = "published", mapped: bool = True) -> Path:
    """Write a vehicle folder with the package's parameters and no others.

    Args:
        folder: is made.
        p: parameters of a car.
        kind: what it will be compared with.
        mapped: False: camber with the sign that it has in ISO axes, and no scale factors for the loads.

    Each wheel has half of the mass of its axle, shared by carrier, knuckle and wheel. The camber of our wheels is the
    roll angle; that of the package is the roll angle times :func:`camber_by_roll`, hence a factor on the coefficients
    of camber. The axles of the package are laterally compliant, with a spring and a damper between axle and body; ours
    are not. If slip is taken at the axle, that spring and damper become the lateral stiffness and damping of our tyres.
    The inertia of the axle's own motion is neglected: 6 % of the dynamic stiffness at 2 Hz.
    """
    folder.mkdir(parents=True)
    length, ratios = p.a + p.b, load_ratios(p) if mapped else (1.0, 1.0)
    spring, damper = (STIFF, 0.0) if kind == "published" else (0.5 * p.K_ras, 0.5 * p.K_rad)  # of each wheel
    for name, camber_gain in zip(("front", "rear"), camber_by_roll(p), strict=True):
        parameters = tyre(p, camber=-camber_gain if mapped else camber_gain, lateral=spring)
        (folder / f"{name}.tir").write_text(write_tir(parameters), encoding="utf-8")

    def axle(stiffness: float, damping: float, torsion: float, track: float) -> dict[str, float]:
        return {"stiffness": stiffness, "damping": damping, "anti_roll": -torsion / track**2}

    spec = {
        "name": folder.name,
        "grade": "B",
        "licence": "BSD-3-Clause",
        "joints": {
            "wheels": {wheel: f"{wheel}_wheel_joint" for wheel in _PLACES},
            "steering": {side: f"front_{side}_steering_joint" for side in ("left", "right")},
            "suspension": {wheel: f"{wheel}_suspension_joint" for wheel in _PLACES},
        },
        "drive": "front",
        "steering": {"law": "ackermann"},
        "tyres": {
            "kind": "magic_formula",
            "rolling_resistance": 0.0,
            "rolling_ratio": 1.0,
            "lateral_damping": damper,
            "file": "front.tir",
            "rear_file": "rear.tir",
            "scale": {"lky": ratios[0], "lmuy": ratios[0]},
            "rear_scale": {"lky": ratios[1], "lmuy": ratios[1]},
        },
        "powertrain": {"max_torque": 1.0, "max_power": 1.0},
        "brakes": {"max_torque": 0.0, "front_share": 0.5},
        "aerodynamics": {"drag_area": 0.0},
        "suspension": {
            "front": axle(p.K_sf, p.K_sdf, p.K_tsf, p.T_f),
            "rear": axle(p.K_sr, p.K_sdr, p.K_tsr, p.T_r),
        },
    }
    control = {
        "wheel_speed": {"kind": "pid", "kp": 0.0},
        "steering": {"kind": "servo", "stiffness": 1e7, "damping": 1e5},
    }
    (folder / "vehicle.yaml").write_text(yaml.safe_dump(spec), encoding="utf-8")
    (folder / "control.yaml").write_text(yaml.safe_dump(control), encoding="utf-8")
    (folder / "sensors.yaml").write_text("mounts: {}\n", encoding="utf-8")

    # Body: what is left of the yaw inertia; its centre such that that of the whole car is a behind the front axle.
    x = (p.m * p.b - p.m_uf * length) / p.m_s
    around = sum(m * (d**2 + 0.25 * t**2) for m, d, t in ((p.m_uf, p.a, p.T_f), (p.m_ur, p.b, p.T_r)))
    yaw = p.I_z - around - p.m_s * (x - p.b) ** 2 - 4.0 * (0.5 * p.I_y_w + 2.0 * _SMALL)
    z = centre_of_sprung_mass(p)[1]
    parts = [_link("base_link", p.m_s, (p.I_Phi_s, p.I_y_s, yaw), centre=(x, 0.0, z))]
    for corner in _PLACES:
        front, side = corner.startswith("front"), 1.0 if corner.endswith("left") else -1.0
        mass, track = (p.m_uf, p.T_f) if front else (p.m_ur, p.T_r)
        position = (length if front else 0.0, 0.5 * side * track, p.R_w)
        parts += _corner(corner, mass=0.5 * mass, position=position, steered=front, p=p)
    text = f'<robot name="{folder.name}" xmlns:drake="http://drake.mit.edu">\n{"".join(parts)}</robot>\n'
    (folder / "main.urdf.xacro").write_text(text, encoding="utf-8")
    return folder


_PLACES = ("front_left", "front_right", "rear_left", "rear_right")
_SMALL = 1e-3  # moment of inertia of carriers and knuckles [kg m²]


def _link(
    name: str,
    mass: float,
    inertia: tuple[float, float, float],
    *,
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0),
    more: str = "",
) -> str:
    ixx, iyy, izz = inertia
    return (
        f'<link name="{name}"><inertial><origin xyz="{centre[0]} {centre[1]} {centre[2]}"/><mass value="{mass}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>{more}</link>\n'
    )


def _joint(name: str, kind: str, parent: str, child: str, axis: str, limit: str, *, origin: str = "0 0 0") -> str:
    text = (
        f'<joint name="{name}" type="{kind}"><origin xyz="{origin}"/><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{axis}"/><limit {limit}/></joint>\n'
    )
    if kind == "prismatic":
        return text
    return text + (
        f'<transmission name="{name}_transmission"><type>transmission_interface/SimpleTransmission</type>'
        f'<joint name="{name}"/><actuator name="{name}_actuator"/></transmission>\n'
    )


def _corner(corner: str, *, mass: float, position: tuple[float, float, float], steered: bool, p: Any) -> list[str]:
    """Carrier, knuckle and wheel of a corner with their joints; mass is that of all of them."""
    small, half = (_SMALL,) * 3, 0.5 * p.I_y_w + (0.0 if steered else _SMALL)
    stiffness = p.K_zt / (1.0 - p.K_zt / 1e9)  # in series with the road's
    contact = (
        f'<collision name="tyre"><origin rpy="{0.5 * math.pi} 0 0"/>'
        f'<geometry><cylinder radius="{p.R_w}" length="0.2"/></geometry><drake:proximity_properties>'
        '<drake:mu_dynamic value="1"/><drake:mu_static value="1"/><drake:hunt_crossley_dissipation value="0"/>'
        f'<drake:point_contact_stiffness value="{stiffness}"/></drake:proximity_properties></collision>'
    )
    carrier, knuckle, wheel = f"{corner}_carrier", f"{corner}_knuckle", f"{corner}_wheel"
    travel = 'lower="-0.3" upper="0.3" effort="0" velocity="10"'
    origin = f"{position[0]} {position[1]} {position[2]}"
    parts = [
        _link(carrier, (0.25 if steered else 0.5) * mass, small),
        _joint(f"{corner}_suspension_joint", "prismatic", "base_link", carrier, "0 0 1", travel, origin=origin),
        _link(wheel, 0.5 * mass, (half, p.I_y_w, half), more=contact),
    ]
    if steered:
        parts.append(_link(knuckle, 0.25 * mass, small))
        turn = 'lower="-1" upper="1" effort="1e6" velocity="10"'
        parts.append(_joint(f"{corner}_steering_joint", "revolute", carrier, knuckle, "0 0 1", turn))
    spin = 'effort="10" velocity="1000"'
    parts.append(_joint(f"{wheel}_joint", "continuous", knuckle if steered else carrier, wheel, "0 1 0", spin))
    return parts


class _Steering(LeafSystem):
    """Desired state of the actuators: both steering joints at the set-point at the end of the step."""

    def __init__(self, steer: Manoeuvre, *, joints: list[int], count: int, step: float) -> None:
        super().__init__()
        self._steer, self._joints, self._count, self._step = steer, joints, count, step
        self.DeclareVectorOutputPort("desired", 2 * count, self._calc, {self.time_ticket()})

    def _calc(self, context: Context, output: BasicVector) -> None:
        set_point, t = np.zeros(2 * self._count), context.get_time() + self._step
        for index in self._joints:
            set_point[index], set_point[self._count + index] = self._steer.angle(t), self._steer.rate(t)
        output.SetFromVector(set_point)


def plant_trace(vehicle: Vehicle, steer: Manoeuvre, point: tuple[float, float], *, step: float = 0.005) -> Trace:
    """Our full model: the plant with its tyres and anti-roll bars.

    Args:
        vehicle: of :func:`write_car`.
        steer: what both front wheels do.
        point: x and z in the vehicle frame of the point whose acceleration is taken [m].
        step: of the plant [s].
    """
    builder = DiagramBuilder()
    parts = make_plant(
        builder, load_world("empty"), {"ego": vehicle}, spec=PlantSpec(time_step=step, contact="point", air_density=0.0)
    )
    plant, part = parts.plant, parts.vehicles["ego"]
    tyres = add_tyres(builder, parts)
    bars = make_axle_forces(plant, part)
    forces = [tyres.generalized_force]
    if bars is not None:
        builder.AddSystem(bars)
        builder.Connect(plant.get_state_output_port(part.instance), bars.get_input_port())
        forces.append(bars.get_output_port())
    total = builder.AddSystem(Adder(len(forces), plant.num_velocities()))
    for index, port in enumerate(forces):
        builder.Connect(port, total.get_input_port(index))
    builder.Connect(total.get_output_port(), plant.get_applied_generalized_force_input_port())
    actuators = [plant.get_joint_actuator(index).joint().index() for index in plant.GetJointActuatorIndices()]
    turned = [actuators.index(joint.index()) for joint in part.steering]
    source = builder.AddSystem(_Steering(steer, joints=turned, count=len(actuators), step=step))
    builder.Connect(source.get_output_port(), plant.get_desired_state_input_port(part.instance))
    log = LogVectorOutput(plant.get_state_output_port(), builder, SAMPLE)
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    set_start(plant, context, part, x=0.0, y=0.0, yaw=0.0, speed=SPEED)
    simulator.AdvanceTo(steer.duration)
    data = log.FindLog(simulator.get_context()).data()
    q = data[part.base.floating_positions_start() :][:7]
    v = data[plant.num_positions() + part.base.floating_velocities_start_in_v() :][:6]
    # Positions lead velocities by half a step: the attitude is turned back to the time of the velocities.
    w, i, j, k = q[:4]
    (x, y, z), turn = v[:3], 0.5 * parts.lead
    attitude = [
        w + turn * (x * i + y * j + z * k),
        i - turn * (x * w + y * k - z * j),
        j - turn * (y * w + z * i - x * k),
        k - turn * (z * w + x * j - y * i),
    ]
    return _trace_of_body(np.vstack([attitude, q[4:]]), v, point)


def _trace_of_body(q: Array, v: Array, point: tuple[float, float]) -> Trace:
    """Return the trace of poses (quaternion, position) and velocities (angular, linear) of the vehicle frame."""
    w, i, j, k = q[:4] / np.linalg.norm(q[:4], axis=0)
    x_axis = np.array([1.0 - 2.0 * (j * j + k * k), 2.0 * (i * j + w * k), 2.0 * (i * k - w * j)])
    z_axis = np.array([2.0 * (i * k + w * j), 2.0 * (j * k - w * i), 1.0 - 2.0 * (i * i + j * j)])
    arm = point[0] * x_axis + point[1] * z_axis
    velocity = v[3:] + np.cross(v[:3], arm, axis=0)
    heading = np.unwrap(np.arctan2(x_axis[1], x_axis[0]))
    along = np.array([np.cos(heading), np.sin(heading)])
    ahead = (along * velocity[:2]).sum(axis=0)
    aside = along[0] * velocity[1] - along[1] * velocity[0]
    time = SAMPLE * np.arange(q.shape[1])
    rate = v[2]
    return Trace(time, rate, np.gradient(aside, SAMPLE) + rate * ahead, ahead)


def single_track_trace(vehicle: Vehicle, steer: Manoeuvre, *, relaxation: bool = False, roll: bool = False) -> Trace:
    """Return the trace of our reduced model with brush tyres; acceleration at its reference point.

    Args:
        vehicle: of :func:`write_car`.
        steer: what the front wheels do.
        relaxation: whether the tyres lag.
        roll: whether the body rolls; the acceleration is then that of the point on the road below the centre of mass.
    """
    builder = DiagramBuilder()
    model = builder.AddSystem(
        SingleTrack(estimate_parameters(vehicle, drag=False, roll=roll), Variant("brush", relaxation, roll=roll))
    )
    angle = builder.AddSystem(_Function(lambda t: [steer.angle(t)], 1))
    none = builder.AddSystem(_Function(lambda t: [0.0, 0.0], 2))
    builder.Connect(angle.get_output_port(), model.steering)
    builder.Connect(none.get_output_port(), model.forces)
    state, motion = (LogVectorOutput(port, builder, SAMPLE) for port in (model.state, model.motion))
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_maximum_step_size(SAMPLE)
    context = simulator.get_mutable_context()
    model.set_state(model.GetMyMutableContextFromRoot(context), vx=SPEED)
    simulator.AdvanceTo(steer.duration)
    states, moved = (log.FindLog(context).data() for log in (state, motion))
    return Trace(SAMPLE * np.arange(states.shape[1]), states[11], moved[2], states[6])


class _Function(LeafSystem):
    """A source of a function of time."""

    def __init__(self, function: Callable[[float], list[float]], size: int) -> None:
        super().__init__()
        self._function = function
        self.DeclareVectorOutputPort("value", size, self._calc, {self.time_ticket()})

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._function(context.get_time()))
