"""Road networks: lanes, connections, stop lines, signals, right of way.

::

    Lane, lane_along                                  lane.py
    Network: StopLine, Signal, Junction               network.py
    network: ── make_network ──► Network              network_spec.py
        .xodr ── read_network ──► Network             opendrive_network.py: _road, _links, _signals, _marks
        <commonRoad> ── read_commonroad ──► Network   commonroad.py
    lanes ── find_conflicts ──► Conflict              conflicts.py
    conflicts, signs ── decide ──► priorities         right_of_way.py
    places ── find_route ──► Route                    routes.py
    Network ──► areas, paint, data of a run folder    paving.py, paint.py, stored.py
"""

from mirdrake.worlds.networks.conflicts import Conflict, find_conflicts
from mirdrake.worlds.networks.lane import Lane, lane_along
from mirdrake.worlds.networks.network import Control, Junction, Network, Signal, StopLine

__all__ = [
    "Conflict",
    "Control",
    "Junction",
    "Lane",
    "Network",
    "Signal",
    "StopLine",
    "find_conflicts",
    "lane_along",
]
