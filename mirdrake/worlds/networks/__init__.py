"""Road networks: lanes, connections, stop lines, signals, right of way.

::

    Lane, lane_along                                  lane.py
    Network: StopLine, Signal, Junction               network.py
    lanes ── find_conflicts ──► Conflict              conflicts.py
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
