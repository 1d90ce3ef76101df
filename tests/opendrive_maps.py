"""OpenDRIVE maps written by hand, whose lanes have closed forms."""

import math
from collections.abc import Iterable, Sequence

HALF_TURN, RIGHT_ANGLE = math.pi, math.pi / 2.0
LANE = 3.5  # [m]


def geometry(x: float, y: float, yaw: float, length: float, shape: str = "<line/>", s: float = 0.0) -> str:
    return f'<geometry s="{s}" x="{x!r}" y="{y!r}" hdg="{yaw!r}" length="{length!r}">{shape}</geometry>'


def arc(x: float, y: float, yaw: float, radius: float, angle: float) -> str:
    """Return an arc that turns by `angle` [rad] with a signed radius, + left."""
    return geometry(x, y, yaw, abs(radius * angle), f'<arc curvature="{1.0 / radius!r}"/>')


def lane(
    number: int, kind: str = "driving", width: float = LANE, before: str = "", after: str = "", more: str = ""
) -> str:
    links = "".join(f'<{tag} id="{to}"/>' for tag, to in (("predecessor", before), ("successor", after)) if to)
    return (
        f'<lane id="{number}" type="{kind}"><link>{links}</link>'
        f'<width sOffset="0" a="{width}" b="0" c="0" d="0"/>{more}</lane>'
    )


def section(left: Sequence[str] = (), right: Sequence[str] = (), s: float = 0.0, centre: str = "") -> str:
    return (
        f'<laneSection s="{s}"><left>{"".join(left)}</left><center><lane id="0" type="none">{centre}</lane></center>'
        f"<right>{''.join(right)}</right></laneSection>"
    )


TWO_WAY = section([lane(1)], [lane(-1)])


def road(
    key: str,
    view: str,
    lanes: str = TWO_WAY,
    *,
    links: str = "",
    junction: str = "-1",
    offset: float = 0.0,
    more: str = "",
    length: float = 0.0,
    rule: str = "RHT",
) -> str:
    return (
        f'<road id="{key}" length="{length}" junction="{junction}" rule="{rule}"><link>{links}</link>'
        f"<planView>{view}</planView>"
        f'<lanes><laneOffset s="0" a="{offset}" b="0" c="0" d="0"/>{lanes}</lanes>{more}</road>'
    )


def linked(before: str = "", after: str = "") -> str:
    """Return links of a road, each written as ``road 3 start`` or ``junction 7``."""
    rows = []
    for tag, text in (("predecessor", before), ("successor", after)):
        if text:
            kind, key, *contact = text.split()
            end = f' contactPoint="{contact[0]}"' if contact else ""
            rows.append(f'<{tag} elementType="{kind}" elementId="{key}"{end}/>')
    return "".join(rows)


def one_lane(before: str, after: str, width: float = LANE) -> str:
    """Return the lane of a connecting road, in the direction of its reference line."""
    return section(right=[lane(-1, width=width, before=before, after=after)])


def junction(key: str, rows: Iterable[tuple[str, str, str]], more: str = "") -> str:
    """Return a junction of incoming road, connecting road and incoming lane; all begin at the incoming road."""
    connections = "".join(
        f'<connection id="{i}" incomingRoad="{a}" connectingRoad="{b}" contactPoint="start">'
        f'<laneLink from="{number}" to="-1"/></connection>'
        for i, (a, b, number) in enumerate(rows)
    )
    return f'<junction id="{key}">{connections}{more}</junction>'


def document(*parts: str) -> str:
    return (
        "<?xml version='1.0'?>\n<OpenDRIVE>\n<header revMajor='1' revMinor='6'/>\n"
        + "\n".join(parts)
        + "\n</OpenDRIVE>"
    )


def signal(key: str, s: float, kind: str, *, orientation: str = "-", dynamic: str = "no", more: str = "") -> str:
    return (
        f'<signal id="{key}" s="{s}" t="5" type="{kind}" dynamic="{dynamic}" orientation="{orientation}" '
        f'zOffset="2">{more}</signal>'
    )


REACH = 10.0  # distance of the arms of a crossing from its middle [m]
WAYS = ("straight", "left", "right")


def connection(direction: int, way: str, x0: float = 0.0, y0: float = 0.0) -> tuple[str, float, int]:
    """Return geometry and length of a lane through a crossing at (x0, y0), and the direction it leads to [deg].

    Straight lanes are 20 m long, left turns arcs with a radius of 11.75 m, right turns with 8.25 m.
    """
    a = math.radians(direction)
    heading = a + HALF_TURN
    x = x0 + REACH * math.cos(a) + LANE / 2.0 * math.sin(heading)
    y = y0 + REACH * math.sin(a) - LANE / 2.0 * math.cos(heading)
    if way == "straight":
        return geometry(x, y, heading, 2.0 * REACH), 2.0 * REACH, (direction + 180) % 360
    radius = REACH + LANE / 2.0 if way == "left" else -(REACH - LANE / 2.0)
    turn = 90 if way == "left" else -90
    return arc(x, y, heading, radius, RIGHT_ANGLE), abs(radius) * RIGHT_ANGLE, (direction + 180 + turn) % 360


def crossing(
    directions: Sequence[int] = (0, 90, 180, 270), signals: dict[int, str] | None = None, more: str = ""
) -> str:
    """Return arms of 50 m that begin 10 m beside the origin, in directions [deg], and all ways between them."""
    parts = []
    rows = []
    for direction in directions:
        a = math.radians(direction)
        view = geometry(REACH * math.cos(a), REACH * math.sin(a), a, 50.0)
        signs = (signals or {}).get(direction, "")
        parts.append(road(str(direction), view, links=linked(before="junction J"), more=f"<signals>{signs}</signals>"))
    for direction in directions:
        for way in WAYS:
            view, _, out = connection(direction, way)
            if out in directions:
                key = f"{direction}_{way}"
                links = linked(f"road {direction} start", f"road {out} start")
                parts.append(road(key, view, one_lane("1", "-1"), links=links, junction="J", offset=LANE / 2.0))
                rows.append((str(direction), key, "1"))
    return document(*parts, junction("J", rows, more))


def grid(n: int, mark: str = "") -> str:
    """Return a town of n x n crossings, 100 m apart, with the road mark `mark` between the lanes of the streets.

    It has 14 n² - 26 n + 8 roads: streets of 80 m, and 12, 6 or 2 ways through a crossing of 4, 3 or 2 of them.
    """
    step = 100.0
    parts: list[str] = []
    # The street at each side of a crossing: its key, its end there, and its lane towards the crossing.
    arms: dict[tuple[int, int, int], tuple[str, str, str]] = {}
    for i, j, direction in ((i, j, d) for i in range(n) for j in range(n) for d in (0, 90)):
        other = (i + 1, j) if direction == 0 else (i, j + 1)
        if max(other) < n:
            a, key = math.radians(direction), f"{i}_{j}_{direction}"
            x, y = i * step + REACH * math.cos(a), j * step + REACH * math.sin(a)
            links = linked(f"junction {i}_{j}", f"junction {other[0]}_{other[1]}")
            lanes = section([lane(1)], [lane(-1)], centre=mark)
            parts.append(road(key, geometry(x, y, a, step - 2.0 * REACH), lanes, links=links))
            arms[i, j, direction] = (key, "start", "1")
            arms[*other, direction + 180] = (key, "end", "-1")
    for i, j in ((i, j) for i in range(n) for j in range(n)):
        rows = []
        for direction, way in ((d, way) for d in (0, 90, 180, 270) for way in WAYS):
            view, _, out = connection(direction, way, i * step, j * step)
            if (i, j, direction) not in arms or (i, j, out % 360) not in arms:
                continue
            key = f"{i}_{j}_{direction}_{way}"
            (before, begin, inner), (after, end, outer) = arms[i, j, direction], arms[i, j, out % 360]
            away = {"1": "-1", "-1": "1"}[outer]
            links = linked(f"road {before} {begin}", f"road {after} {end}")
            lanes = one_lane(inner, away)
            parts.append(road(key, view, lanes, links=links, junction=f"{i}_{j}", offset=LANE / 2.0))
            rows.append((before, key, inner))
        parts.append(junction(f"{i}_{j}", rows))
    return document(*parts)
