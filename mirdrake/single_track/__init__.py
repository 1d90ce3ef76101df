"""Single-track model of a vehicle, for fast studies, linearisation and identification."""

from mirdrake.single_track.control import SingleTrackControl
from mirdrake.single_track.from_vehicle import estimate_parameters, make_single_track
from mirdrake.single_track.linear import (
    LinearSingleTrack,
    SteadyState,
    characteristic_speed,
    find_steady_state,
    linearize_single_track,
    steady_gain,
    understeer_gradient,
)
from mirdrake.single_track.parameters import SingleTrackParameters
from mirdrake.single_track.system import SingleTrack, SingleTrack_
from mirdrake.single_track.vehicle import make_single_track_vehicle

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
    "understeer_gradient",
]
