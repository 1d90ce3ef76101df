"""Single-track model of a vehicle, for fast studies, linearisation and identification.

A name loads its module when it is first used: batches need the equations only, not Drake's plant and the controllers.
"""

from typing import TYPE_CHECKING

from mirdrake.core.deferred import defer

if TYPE_CHECKING:
    from mirdrake.single_track.control import SingleTrackControl as SingleTrackControl
    from mirdrake.single_track.from_vehicle import estimate_parameters as estimate_parameters
    from mirdrake.single_track.from_vehicle import make_single_track as make_single_track
    from mirdrake.single_track.linear import LinearSingleTrack as LinearSingleTrack
    from mirdrake.single_track.linear import SteadyState as SteadyState
    from mirdrake.single_track.linear import characteristic_speed as characteristic_speed
    from mirdrake.single_track.linear import find_steady_state as find_steady_state
    from mirdrake.single_track.linear import linearize_single_track as linearize_single_track
    from mirdrake.single_track.linear import steady_gain as steady_gain
    from mirdrake.single_track.linear import steady_steering as steady_steering
    from mirdrake.single_track.linear import understeer_gradient as understeer_gradient
    from mirdrake.single_track.linear import zero_side_slip_ratio as zero_side_slip_ratio
    from mirdrake.single_track.parameters import SingleTrackParameters as SingleTrackParameters
    from mirdrake.single_track.system import SingleTrack as SingleTrack
    from mirdrake.single_track.system import SingleTrack_ as SingleTrack_
    from mirdrake.single_track.vehicle import make_single_track_vehicle as make_single_track_vehicle

_MODULES = {
    "LinearSingleTrack": "linear",
    "SingleTrack": "system",
    "SingleTrackControl": "control",
    "SingleTrackParameters": "parameters",
    "SingleTrack_": "system",
    "SteadyState": "linear",
    "characteristic_speed": "linear",
    "estimate_parameters": "from_vehicle",
    "find_steady_state": "linear",
    "linearize_single_track": "linear",
    "make_single_track": "from_vehicle",
    "make_single_track_vehicle": "vehicle",
    "steady_gain": "linear",
    "steady_steering": "linear",
    "understeer_gradient": "linear",
    "zero_side_slip_ratio": "linear",
}

__all__ = [
    "LinearSingleTrack",
    "SingleTrack",
    "SingleTrackControl",
    "SingleTrackParameters",
    "SingleTrack_",
    "SteadyState",
    "characteristic_speed",
    "estimate_parameters",
    "find_steady_state",
    "linearize_single_track",
    "make_single_track",
    "make_single_track_vehicle",
    "steady_gain",
    "steady_steering",
    "understeer_gradient",
    "zero_side_slip_ratio",
]

__getattr__ = defer(__name__, _MODULES)
