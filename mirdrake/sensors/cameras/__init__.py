"""Cameras: colour, depth, stereo, labels and lens distortion; rendered by Drake's VTK engine without a display."""
