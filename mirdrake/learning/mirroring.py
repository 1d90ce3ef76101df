"""Signals of a vehicle under reflection in its vertical plane of symmetry, for mirrored pictures.

Forward, upward and pitching quantities stay; lateral ones, roll and yaw change sign (x forward, y left, z up, ISO
8855). Positions in the world and signals of single wheels or sides have no mirrored value by themselves.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mirdrake.core.errors import ConfigError

KEPT = (
    "vx", "vz", "wy", "z", "pitch", "speed", "speed_command", "speed_setpoint", "speed_trim", "wheels_on_road",
    "powertrain.throttle", "powertrain.brake", "powertrain.drive_torque", "powertrain.brake_torque",
)  # fmt: skip
"""Signals that a reflection keeps."""

REVERSED = (
    "vy", "wx", "wz", "roll", "steering", "steering_command", "steering_setpoint", "lateral_error", "heading_error",
    "curvature",
)  # fmt: skip
"""Signals whose sign a reflection changes."""


def mirror_signs(names: Sequence[str]) -> NDArray[np.float32]:
    """Return the factor, 1 or -1, of each signal under reflection (names).

    Args:
        names: signals of vehicles, such as ``ego.wz``.

    Raises:
        ConfigError: a signal has no known mirrored value.
    """
    signs = []
    for name in names:
        signal = name.partition(".")[2]
        if signal not in KEPT and signal not in REVERSED:
            raise ConfigError(
                f"input '{name}' has no known mirrored value; set train.mirror: false, or use one of "
                f"{', '.join((*KEPT, *REVERSED))}"
            )
        signs.append(1.0 if signal in KEPT else -1.0)
    return np.array(signs, dtype=np.float32)
