"""Colours of Gazebo's named materials."""

Rgba = tuple[float, float, float, float]

COLOURS: dict[str, Rgba] = {
    "Black": (0.05, 0.05, 0.05, 1.0), "White": (1.0, 1.0, 1.0, 1.0), "Grey": (0.7, 0.7, 0.7, 1.0),
    "DarkGrey": (0.175, 0.175, 0.175, 1.0), "FlatBlack": (0.1, 0.1, 0.1, 1.0), "Red": (1.0, 0.0, 0.0, 1.0),
    "Green": (0.0, 1.0, 0.0, 1.0), "Blue": (0.0, 0.0, 1.0, 1.0), "Yellow": (1.0, 1.0, 0.0, 1.0),
    "Orange": (1.0, 0.5, 0.0, 1.0), "Purple": (1.0, 0.0, 1.0, 1.0), "Turquoise": (0.0, 1.0, 1.0, 1.0),
    "Gold": (0.8, 0.65, 0.15, 1.0), "Indigo": (0.33, 0.0, 0.5, 1.0), "SkyBlue": (0.13, 0.44, 0.7, 1.0),
    "Wood": (0.6, 0.4, 0.2, 1.0),
}  # fmt: skip
"""Diffuse colours of Gazebo's named materials, rounded."""


def colour_of(name: str) -> Rgba | None:
    """Return the colour of a material of Gazebo by its name; None for textures and unknown names."""
    return COLOURS.get(name.rpartition("/")[2])
