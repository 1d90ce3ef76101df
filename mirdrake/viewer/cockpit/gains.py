"""Sliders of the gains of a vehicle's loops."""

from mirdrake.vehicles.spec import RuntimeGain


def slider_of(gain: RuntimeGain) -> dict[str, str | float]:
    """Return path, unit, value and maximum of a gain's slider; at most five times the value in control.yaml."""
    return {
        "path": gain.path,
        "unit": "" if gain.unit == "1" else gain.unit,
        "given": gain.value,
        "most": 1.0 if gain.value == 0.0 else round(5.0 * gain.value, 6),
    }
