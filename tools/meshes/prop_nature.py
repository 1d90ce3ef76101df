"""A person and a tree: soft bodies, and leaves one by one."""

from __future__ import annotations

import numpy as np

from mirdrake.vehicles.bodywork.mesh import Mesh
from tools.meshes.outlines.curves import Array
from tools.meshes.prop_shapes import Field, ball, joined, limb, soft


def _pair(field: Field) -> Field:
    """Return a field and its mirror image at y = 0."""
    return lambda p: field(np.stack([p[..., 0], np.abs(p[..., 1]), p[..., 2]], axis=-1))


def make_pedestrian() -> Mesh:
    """Return a standing person who looks along x: jacket over a shirt, trousers, shoes; 1.75 m tall."""
    mesh = Mesh()
    jacket = joined([
        joined([
            _pair(limb([(-0.014, 0.0, 1.398), (-0.012, 0.145, 1.360)], (0.062, 0.052), flat=0.95)),
            limb([(0.0, -0.070, 1.25), (0.0, 0.070, 1.25)], (0.092, 0.092)),
            limb([(-0.004, -0.056, 1.08), (-0.004, 0.056, 1.08)], (0.081, 0.081), flat=0.98),
            limb([(-0.004, -0.060, 0.915), (-0.004, 0.060, 0.915)], (0.097, 0.097)),
        ], 0.12),
        _pair(limb([(-0.012, 0.176, 1.350), (-0.030, 0.232, 1.115), (0.018, 0.262, 0.895)], (0.056, 0.048, 0.040))),
    ], 0.045)  # fmt: skip
    neck = ball((0.030, 0.0, 1.476), (0.058, 0.056, 0.056))

    def worn(p: Array) -> Array:
        return np.maximum(jacket(p), -neck(p))

    mesh.add_mesh(soft("paint", worn, (-0.2, -0.34, 0.78), (0.2, 0.34, 1.52), 0.0235))
    collar = limb([(-0.004, 0.0, 1.40), (-0.002, 0.0, 1.440)], (0.064, 0.060))
    mesh.add_mesh(soft("shirt", collar, (-0.12, -0.12, 1.30), (0.12, 0.12, 1.56), 0.022))
    leg = np.array([(0.0, 0.076, 0.86), (0.010, 0.094, 0.48), (-0.015, 0.104, 0.075)])
    trousers = joined([
        limb([(-0.004, -0.050, 0.900), (-0.004, 0.050, 0.900)], (0.082, 0.082)),
        *[limb((leg * [1, side, 1]).tolist(), (0.080, 0.062, 0.052)) for side in (-1.0, 1.0)],
    ], 0.05)  # fmt: skip
    mesh.add_mesh(soft("trousers", trousers, (-0.15, -0.22, 0.0), (0.15, 0.22, 0.98), 0.0255))
    shoe = joined([
        limb([(-0.050, 0.104, 0.050), (0.060, 0.112, 0.048), (0.150, 0.120, 0.036)], (0.048, 0.047, 0.036)),
        limb([(-0.035, 0.104, 0.06), (-0.020, 0.104, 0.10)], (0.046, 0.046)),
    ], 0.03)  # fmt: skip

    def upper(p: Array) -> Array:
        return np.maximum(shoe(p), 0.016 - p[..., 2])

    def sole(p: Array) -> Array:
        return np.maximum(shoe(p * [1, 1, 0] + [0, 0, 0.034]) - 0.005, np.abs(p[..., 2] - 0.010) - 0.010)

    mesh.add_mesh(soft("shoe", _pair(upper), (-0.13, -0.19, 0.0), (0.22, 0.19, 0.17), 0.026))
    mesh.add_mesh(soft("sole", _pair(sole), (-0.13, -0.19, -0.012), (0.22, 0.19, 0.04), 0.0145))
    hand = joined([
        limb([(0.024, 0.270, 0.875), (0.040, 0.272, 0.835)], (0.030, 0.037), flat=0.8),
        limb([(0.040, 0.272, 0.825), (0.052, 0.268, 0.760)], (0.036, 0.024), flat=0.7),
        limb([(0.055, 0.261, 0.840), (0.085, 0.251, 0.795)], (0.016, 0.011)),
    ], 0.02)  # fmt: skip
    mesh.add_mesh(soft("skin", _pair(hand), (-0.03, -0.33, 0.72), (0.12, 0.33, 0.93), 0.020))

    def grown(part: Field) -> Field:
        """Return a part of the head, a little larger about the crown."""
        crown = np.array([0.0, 0.0, 1.751])
        return lambda p: 1.07 * part((p - crown) / 1.07 + crown)

    head = joined([
        ball((0.000, 0.0, 1.634), (0.099, 0.080, 0.108)),
        ball((0.034, 0.0, 1.568), (0.061, 0.056, 0.062)),
        limb([(-0.022, 0.0, 1.42), (-0.010, 0.0, 1.56)], (0.052, 0.050)),
        limb([(0.093, 0.0, 1.634), (0.106, 0.0, 1.605)], (0.007, 0.012)),
        _pair(ball((-0.006, 0.082, 1.614), (0.018, 0.010, 0.030))),
    ], 0.028)  # fmt: skip
    mesh.add_mesh(soft("skin", grown(head), (-0.14, -0.13, 1.38), (0.15, 0.13, 1.78), 0.018))
    hair = joined([ball((-0.014, 0.0, 1.657), (0.103, 0.089, 0.095)), ball((-0.035, 0.0, 1.60), (0.074, 0.079, 0.070))],
                  0.02)  # fmt: skip

    def fringe(p: Array) -> Array:
        edge = 0.055 + 0.25 * (p[..., 2] - 1.70) - 0.35 * np.maximum(1.655 - p[..., 2], 0.0)
        return np.maximum(hair(p), p[..., 0] - edge)

    mesh.add_mesh(soft("hair", grown(fringe), (-0.15, -0.12, 1.50), (0.13, 0.12, 1.78), 0.020))
    for y in (-0.032, 0.032):
        mesh.add_mesh(soft("eye", grown(ball((0.0885, y, 1.637), (0.008, 0.011, 0.008))), (0.06, y - 0.025, 1.59),
                           (0.12, y + 0.025, 1.66), 0.008))  # fmt: skip
    mouth = limb([(0.0905, -0.020, 1.567), (0.0950, 0.0, 1.565), (0.0905, 0.020, 1.567)], (0.004, 0.006, 0.004))
    mesh.add_mesh(soft("lips", grown(mouth), (0.07, -0.04, 1.53), (0.12, 0.04, 1.58), 0.008))
    return mesh


def make_tree() -> Mesh:
    """A broad-leaved tree, 7 m tall, crown 5 m wide: a trunk, limbs into the crown, leaves around dark clumps."""
    mesh = Mesh()
    trunk = [(0.0, 0.0, -0.3), (0.02, -0.01, 0.8), (-0.03, 0.03, 1.8), (0.04, 0.0, 2.9), (0.0, 0.05, 4.6)]
    arms = [
        ([(-0.02, 0.02, 1.9), (0.55, 0.45, 2.9), (1.05, 0.85, 3.9)], (0.11, 0.08, 0.04)),
        ([(0.0, 0.02, 2.1), (-0.55, 0.50, 3.0), (-1.05, 0.75, 3.9)], (0.10, 0.08, 0.04)),
        ([(0.0, 0.02, 2.0), (-0.35, -0.65, 2.9), (-0.60, -1.15, 3.8)], (0.11, 0.08, 0.04)),
        ([(0.02, 0.02, 2.3), (0.55, -0.50, 3.2), (0.95, -0.75, 4.0)], (0.10, 0.07, 0.04)),
    ]
    bark = joined([
        limb(trunk, (0.27, 0.185, 0.165, 0.13, 0.05)),
        *[limb(points, radii) for points, radii in arms],
        *[limb([(0.0, 0.0, 0.22), (0.38 * np.cos(a), 0.38 * np.sin(a), -0.06)], (0.13, 0.05))
          for a in (0.3, 1.7, 2.9, 4.2, 5.4)],
    ], 0.12)  # fmt: skip

    def rooted(p: Array) -> Array:
        return np.maximum(bark(p), -p[..., 2])

    mesh.add_mesh(soft("bark", rooted, (-1.3, -1.4, -0.13), (1.3, 1.2, 4.8), 0.085))
    clumps = [
        ((0.00, 0.00, 5.90), 1.08), ((0.95, 0.55, 5.15), 1.10), ((-0.90, 0.70, 5.25), 1.08),
        ((-0.55, -0.95, 5.10), 1.12), ((0.80, -0.80, 5.30), 1.02), ((1.35, 0.30, 4.00), 1.10),
        ((0.45, 1.35, 4.05), 1.08), ((-0.90, 1.15, 3.90), 1.05), ((-1.45, 0.05, 4.10), 1.05),
        ((-0.95, -1.10, 3.85), 1.10), ((0.25, -1.45, 4.05), 1.02), ((1.20, -0.95, 3.95), 1.08),
        ((0.00, 0.00, 4.30), 1.45),
    ]  # fmt: skip
    balls = [ball(position, (0.86 * r, 0.86 * r, 0.80 * r)) for position, r in clumps]
    mesh.add_mesh(soft("shade", joined(balls, 0.15), (-2.9, -2.9, 2.4), (2.9, 2.9, 7.2), 0.24))
    mesh.add_mesh(_leaves(clumps, 2600))
    return mesh


def _leaves(clumps: list[tuple[tuple[float, float, float], float]], count: int) -> Mesh:
    """Folded leaves of three greens spread evenly over clumps, where no other clump covers them."""
    mesh = Mesh()
    random = np.random.default_rng(7)
    centres, radii = np.array([position for position, _ in clumps]), np.array([r for _, r in clumps])
    share = radii**2 / (radii**2).sum()
    triangles: dict[str, list[Array]] = {"paint": [], "leaf_light": [], "leaf_dark": []}
    normals: dict[str, list[Array]] = {name: [] for name in triangles}
    for k in range(len(clumps)):
        n = round(2.0 * count * float(share[k]))
        z = 1.0 - 2.0 * (np.arange(n) + 0.5) / n
        turn = np.pi * (1.0 + 5.0**0.5) * (np.arange(n) + 0.5)
        out = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)
        position = centres[k] + radii[k] * out * np.array([1.0, 1.0, 0.93]) * random.uniform(0.86, 1.03, (n, 1))
        free = np.linalg.norm(position[:, None] - centres, axis=2) - 0.90 * radii
        free[:, k] = 1.0
        keep = free.min(axis=1) > 0
        for p, u in zip(position[keep], out[keep], strict=True):
            direction = u + random.normal(0.0, 0.38, 3)
            direction /= np.linalg.norm(direction)
            side = np.cross(direction, random.normal(0.0, 1.0, 3))
            side /= np.linalg.norm(side)
            along = np.cross(direction, side)
            size = random.uniform(0.13, 0.21)
            a, b = p - size * along, p + size * along
            c, d = p + 0.62 * size * side + 0.25 * size * direction, p - 0.62 * size * side + 0.25 * size * direction
            # Paler above and outside, darker below.
            level = 0.62 * u[2] + 0.30 * random.normal()
            name = "leaf_light" if level > 0.38 else "leaf_dark" if level < -0.25 else "paint"
            soft_normal = 0.55 * u + 0.45 * direction
            triangles[name].append(np.array([[a, b, c], [a, d, b]]))
            normals[name].append(np.broadcast_to(soft_normal / np.linalg.norm(soft_normal), (2, 3, 3)))
    for name in triangles:
        mesh.add(name, np.concatenate(triangles[name]), np.concatenate(normals[name]))
    return mesh
