"""Mass and inertia of single links; impossible values are replaced by those of the link's shapes."""

from collections.abc import Iterable, Sequence
from itertools import permutations
from math import isfinite, sqrt

import numpy as np
from pydrake.math import RigidTransform

from mirdrake.importing.changes import Changes, Code
from mirdrake.importing.shape import Vector
from mirdrake.importing.vehicles.car import Mass
from mirdrake.importing.vehicles.kinematics import Tree
from mirdrake.importing.vehicles.round_shapes import Bounds, bounds_in, join_bounds

DENSITY = 140.0
"""Mass over the volume of the box around it [kg/m³]: cars 1600 kg in 4.2 x 1.8 x 1.5 m, models 3.5 kg in 0.03 m³."""

FARTHEST, NEAREST = 3.0, 0.01
"""Radius of gyration over half the diagonal of the link's shapes: an inertia outside of this range is wrong."""

OUTSIDE = 1.2
"""Root mean square distance of the mass along an axis over the reach of the shapes: above this, axes are exchanged."""

FLAT = 2e-5
"""Relative margin of a flat plate to the triangle inequality, which six printed digits then satisfy."""


def box_inertia(mass: float, edges: Vector) -> Vector:
    """Return inertia of a homogeneous box about its centre [kg m²]."""
    # A flat box keeps moments above zero.
    squares = np.maximum(edges, 1e-6) ** 2
    moments: Vector = np.diag(mass / 12.0 * (squares.sum() - squares))
    return moments


def cylinder_inertia(mass: float, *, radius: float, length: float, axis: int) -> Vector:
    """Return inertia of a solid cylinder about its centre [kg m²]; `axis` 1 for a wheel, 2 for a knuckle."""
    moments = np.full(3, mass * (3.0 * radius**2 + length**2) / 12.0)
    moments[axis] = mass * radius**2 / 2.0
    return np.diag(moments)


def gather(
    tree: Tree,
    links: Sequence[str],
    X_MP: RigidTransform,
    size: float,
    changes: Changes,
    *,
    wheel: tuple[float, float] | None = None,
) -> Mass:
    """Return the mass properties of links that move together, in the frame P of their part; mass 0 for none.

    Args:
        tree: tree of the model.
        links: links that move together.
        X_MP: frame of the part.
        size: half the diagonal of a link without shapes [m].
        changes: receives the repairs.
        wheel: radius and width [m] if the part is a wheel.
    """
    X_PM = X_MP.inverse()
    whole = add_masses([_in_part(tree, name, X_PM, size, changes, wheel) for name in links])
    # Values below a micrometre are rounding of the poses.
    whole.com = np.where(np.abs(whole.com) < 1e-6, 0.0, whole.com)
    return whole


def add_masses(masses: Sequence[Mass]) -> Mass:
    """Return the sum of rigidly connected masses (parallel axis theorem)."""
    total = sum(item.mass for item in masses)
    if total <= 0.0:
        return Mass()
    com = sum((item.mass * item.com for item in masses), np.zeros(3)) / total
    inertia = sum((item.inertia + item.mass * _steiner(item.com - com) for item in masses), np.zeros((3, 3)))
    return Mass(total, com, inertia)


def _steiner(arm: Vector) -> Vector:
    moment: Vector = (arm @ arm) * np.eye(3) - np.outer(arm, arm)
    return moment


def _in_part(
    tree: Tree, name: str, X_PM: RigidTransform, size: float, changes: Changes, wheel: tuple[float, float] | None
) -> Mass:
    """Return the corrected mass properties of a link."""
    link = tree.model.links[name]
    inertial = link.inertial
    if inertial is None:
        return Mass()
    part, where = f"link '{name}'", inertial.where or link.where
    if not isfinite(inertial.mass) or inertial.mass <= 0.0:
        # A mass of zero is common for links that are only frames, so it is not reported.
        if inertial.mass != 0.0:
            became = "none; the part it belongs to has the mass"
            changes.add(Code.MASS, where, f"{part}: mass", f"{inertial.mass:g} kg", became, "not above zero")
        return Mass()
    # An impossible tensor is replaced by that of a cylinder for wheels, else of the box around the shapes.
    X_PL = X_PM.multiply(tree.poses[name])
    R_LI = inertial.X_LI.rotation().matrix()
    bounds = join_bounds(bounds_in(shape, RigidTransform()) for shape in (*link.collisions, *link.visuals))
    com_L, mass = inertial.X_LI.translation(), inertial.mass
    fault = _fault(np.asarray(inertial.inertia, dtype=float), mass, bounds, size)
    if fault:
        # Small links of a wheel are not cylinders of the size of the wheel.
        if wheel is not None and (bounds is None or (bounds[1] - bounds[0]).max() > wheel[0]):
            radius, width = wheel
            # The spin axis is y of the part, so the tensor is rotated from the part into the link.
            R_LP = X_PL.rotation().matrix().T
            inertia_L = R_LP @ cylinder_inertia(mass, radius=radius, length=width, axis=1) @ R_LP.T
            became = f"of a solid cylinder of radius {radius:.4g} m, {width:.4g} m wide"
        elif bounds is None:
            edges = np.full(3, 0.4 * size)
            inertia_L = box_inertia(mass, edges)
            became = f"of a box with edges of {edges[0]:.3g} m (the link has no shapes)"
        else:
            edges = bounds[1] - bounds[0]
            inertia_L = box_inertia(mass, edges)
            became = f"of the box around its shapes, {edges[0]:.3g} x {edges[1]:.3g} x {edges[2]:.3g} m"
        was = f"{moments_text(np.asarray(inertial.inertia, dtype=float))} for {mass:.4g} kg"
        changes.add(Code.INERTIA, where, f"{part}: inertia", was, became, fault)
    else:
        inertia_L = R_LI @ widen(np.asarray(inertial.inertia, dtype=float)) @ R_LI.T
        # A possible tensor may have exchanged axes, a common mistake of files that were rotated by hand.
        order = _exchanged_axes(inertia_L, mass, bounds, com_L) if wheel is None else (0, 1, 2)
        if order != (0, 1, 2):
            was = _moments(inertia_L.diagonal())
            inertia_L = inertia_L[np.ix_(order, order)]
            why = f"the mass would be outside of the link's shapes along {_outside(order)}"
            changes.add(Code.INERTIA, where, f"{part}: inertia along x, y, z", was, _moments(inertia_L.diagonal()), why)
    # A centre of mass far outside of the link is usually a value of another frame.
    middle = np.zeros(3) if bounds is None else 0.5 * (bounds[0] + bounds[1])
    distance = float(np.linalg.norm(com_L - middle))
    # The comparison is false for NaN, too.
    if not distance <= FARTHEST * _half_size(bounds, size):
        became = "in the link's origin" if bounds is None else "in the middle of its shapes"
        why = f"the link is {2.0 * _half_size(bounds, size):.3g} m large"
        changes.add(Code.MASS, where, f"{part}: centre of mass", f"{distance:.4g} m from there", became, why)
        com_L = middle
    R_PL = X_PL.rotation().matrix()
    return Mass(mass, X_PL.multiply(com_L), R_PL @ inertia_L @ R_PL.T)


def _half_size(bounds: Bounds | None, size: float) -> float:
    """Return half the diagonal of a link's shapes [m]."""
    return size if bounds is None else max(0.5 * float(np.linalg.norm(bounds[1] - bounds[0])), 1e-4)


def _fault(inertia: Vector, mass: float, bounds: Bounds | None, size: float) -> str:
    """Return why no body can have this inertia; "" if one can."""
    if not np.isfinite(inertia).all():
        return "not a number"
    # 2 % beyond the triangle inequality is rounding in the file.
    low, middle, high = np.linalg.eigvalsh(0.5 * (inertia + inertia.T))
    if low <= 0.0:
        return "principal moments should be above zero"
    if low + middle < 0.98 * high:
        return f"breaks the triangle inequality ({low:.4g} + {middle:.4g} < {high:.4g}); no body has it"
    half = _half_size(bounds, size)
    gyration = sqrt(high / mass)
    if gyration > FARTHEST * half:
        return f"the mass would be {gyration:.3g} m from its centre, in a link of {2.0 * half:.3g} m"
    if gyration < NEAREST * half:
        return f"all mass would be within {gyration:.2g} m, in a link of {2.0 * half:.3g} m"
    # A power of ten times the identity is a placeholder, unless the shapes confirm it.
    identity = np.abs(inertia - inertia[0, 0] * np.eye(3)).max() <= 1e-12 * high
    # 0.5 is far from the exponent of any power of ten.
    power = np.log10(inertia[0, 0]) if identity else 0.5
    if identity and abs(power - round(power)) < 1e-9 and bounds is not None:
        expected = box_inertia(mass, bounds[1] - bounds[0]).diagonal()
        if (expected > 1.5 * high).any() or (expected < high / 1.5).any():
            return "identity, a placeholder"
    return ""


def _exchanged_axes(inertia: Vector, mass: float, bounds: Bounds | None, com: Vector) -> tuple[int, ...]:
    """Order of the axes in which an inertia fits the shapes; (0, 1, 2) if it fits as it is, or in no order.

    The mass of a link lies within its shapes. Its root mean square distance from the centre of mass along an axis is
    therefore at most the distance of the farthest shape along this axis. Files whose x and y are exchanged break this.

    Args:
        inertia: about the centre of mass, along the link's axes [kg m²].
        mass: [kg].
        bounds: bounds of the link's shapes along its axes [m]; None if it has none.
        com: centre of mass in the link's frame [m].
    """
    as_stated = (0, 1, 2)
    if bounds is None:
        return as_stated
    reach = np.maximum(np.abs(bounds[0] - com), np.abs(bounds[1] - com))
    # Second moment along an axis: ∫x² dm = (Iyy + Izz - Ixx) / 2 = tr(I) / 2 - Ixx.
    spread = np.sqrt(np.maximum(0.5 * np.trace(inertia) - inertia.diagonal(), 0.0) / mass)
    if (spread <= OUTSIDE * reach).all():
        return as_stated
    fitting = [order for order in permutations(range(3)) if (spread[list(order)] <= reach).all()]
    # The mistake is most likely the one with the fewest exchanged axes.
    return min(fitting, key=lambda order: sum(a != b for a, b in zip(order, as_stated, strict=True)), default=as_stated)


def _outside(order: tuple[int, ...]) -> str:
    return " and ".join(name for name, old, new in zip("xyz", order, range(3), strict=True) if old != new)


def _moments(values: Iterable[float]) -> str:
    return " / ".join(f"{value:.4g}" for value in values) + " kg m²"


def widen(inertia: Vector) -> Vector:
    """Return a symmetric tensor that fulfils the triangle inequality with a small margin."""
    symmetric: Vector = 0.5 * (inertia + inertia.T)
    low, middle, high = np.linalg.eigvalsh(symmetric)
    # Adding c times the identity closes a lack of c: the two small moments gain 2 c, the largest gains c.
    lack = high * (1.0 + FLAT) - (low + middle)
    widened: Vector = symmetric + max(lack, 0.0) * np.eye(3)
    return widened


def moments_text(inertia: Vector) -> str:
    """Return principal moments for a report."""
    if not np.isfinite(inertia).all():
        return "not a number"
    return _moments(np.linalg.eigvalsh(0.5 * (inertia + inertia.T)))
