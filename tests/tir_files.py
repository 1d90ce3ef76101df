"""Text of .tir files of given parameters, for tests of what reads them."""

import math
from dataclasses import asdict

from mirdrake.tyres.magic_formula_parameters import MagicFormulaParameters

UNITS = "[UNITS]\nLENGTH = 'meter'\nFORCE = 'newton'\nANGLE = 'radians'\nMASS = 'kg'\nTIME = 'second'\n"


def write_tir(parameters: MagicFormulaParameters) -> str:
    """Return a file in SI units; coefficients without value, such as FZMAX without a limit, are left out."""
    fittyp = {"5.2": 6, "6.1": 61, "6.2": 62}[parameters.version]
    lines = [
        f"{key.upper()} = {value!r}"
        for key, value in asdict(parameters).items()
        if isinstance(value, int | float) and math.isfinite(value)
    ]
    # The reader needs these sections, but not that a coefficient is in a certain one.
    sections = ["[DIMENSION]", "[VERTICAL]", "[LONGITUDINAL_COEFFICIENTS]", "[LATERAL_COEFFICIENTS]"]
    return UNITS + "\n".join(["[MODEL]", f"FITTYP = {fittyp}", *sections, *lines]) + "\n"
