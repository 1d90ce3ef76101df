"""Parameters of a Magic Formula tyre, with the names of .tir files.

The names are those of the MF-Tyre manuals and of H. B. Pacejka, Tyre and Vehicle Dynamics, 3rd ed., section 4.3.2 and
table A3.1 (there pCx1, in the file PCX1, here pcx1). All are for ISO-W axes: PKY1 and PDY1 are negative.
"""

from dataclasses import dataclass
from math import inf
from typing import Literal

Version = Literal["5.2", "6.1", "6.2"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MagicFormulaParameters:
    """Parameters of the Magic Formula in SI units; the defaults have no effect.

    Attributes:
        version: version of the formulas; 6.1 and 6.2 differ in vertical behaviour only, so they are the same here.
        unloaded_radius: free radius R0 [m].
        fnomin: nominal load Fz0 [N].
        longvl: speed of the measurements V0 [m/s].
        vxlow: speed below which shifts and trail fade out [m/s].
        nompres: nominal inflation pressure [Pa]; 0: no pressure in the file.
        inflpres: default pressure [Pa]; 0: the nominal one.
        fzmin: smallest load for which the coefficients hold [N].
        fzmax: largest load for which the coefficients hold [N].
        longitudinal_stiffness: longitudinal stiffness of the carcass [N/m]; 0: unknown.
        lateral_stiffness: lateral stiffness of the carcass [N/m]; 0: unknown.
        vertical_stiffness: stiffness at the nominal load [N/m]; 0: unknown.
        vertical_damping: damping at the nominal load [N s/m].
        qfz2: part of the vertical force that grows with the square of the deflection [1].
        qv2: growth of the vertical force with the speed of the tread over V0 [1].
        others: coefficients, in groups below.
    """

    version: Version = "6.1"
    unloaded_radius: float
    fnomin: float
    longvl: float = 16.7
    vxlow: float = 1.0
    nompres: float = 0.0
    inflpres: float = 0.0
    fzmin: float = 0.0
    fzmax: float = inf
    longitudinal_stiffness: float = 0.0
    lateral_stiffness: float = 0.0
    vertical_stiffness: float = 0.0
    vertical_damping: float = 0.0
    qfz2: float = 0.0
    qv2: float = 0.0
    # Scale factors: of nominal load, shape, peak friction, curvature, stiffness, shifts, camber, trail and so on [1].
    lfzo: float = 1.0
    lcx: float = 1.0
    lmux: float = 1.0
    lex: float = 1.0
    lkx: float = 1.0
    lhx: float = 1.0
    lvx: float = 1.0
    lcy: float = 1.0
    lmuy: float = 1.0
    ley: float = 1.0
    lky: float = 1.0
    lkyc: float = 1.0
    lkzc: float = 1.0
    lhy: float = 1.0
    lvy: float = 1.0
    ltr: float = 1.0
    lres: float = 1.0
    lxal: float = 1.0
    lyka: float = 1.0
    lvyka: float = 1.0
    ls: float = 1.0
    lmx: float = 1.0
    lvmx: float = 1.0
    lmy: float = 1.0
    lsgkp: float = 1.0
    lsgal: float = 1.0

    # Longitudinal force [1].
    pcx1: float
    pdx1: float
    pdx2: float = 0.0
    pdx3: float = 0.0
    pex1: float = 0.0
    pex2: float = 0.0
    pex3: float = 0.0
    pex4: float = 0.0
    pkx1: float
    pkx2: float = 0.0
    pkx3: float = 0.0
    phx1: float = 0.0
    phx2: float = 0.0
    pvx1: float = 0.0
    pvx2: float = 0.0
    ppx1: float = 0.0
    ppx2: float = 0.0
    ppx3: float = 0.0
    ppx4: float = 0.0
    rbx1: float = 0.0
    rbx2: float = 0.0
    rbx3: float = 0.0
    rcx1: float = 0.0
    rex1: float = 0.0
    rex2: float = 0.0
    rhx1: float = 0.0

    # Lateral force [1].
    pcy1: float
    pdy1: float
    pdy2: float = 0.0
    pdy3: float = 0.0
    pey1: float = 0.0
    pey2: float = 0.0
    pey3: float = 0.0
    pey4: float = 0.0
    pey5: float = 0.0
    pky1: float
    pky2: float
    pky3: float = 0.0
    pky4: float = 2.0
    pky5: float = 0.0
    pky6: float = 0.0
    pky7: float = 0.0
    phy1: float = 0.0
    phy2: float = 0.0
    phy3: float = 0.0
    pvy1: float = 0.0
    pvy2: float = 0.0
    pvy3: float = 0.0
    pvy4: float = 0.0
    ppy1: float = 0.0
    ppy2: float = 0.0
    ppy3: float = 0.0
    ppy4: float = 0.0
    ppy5: float = 0.0
    rby1: float = 0.0
    rby2: float = 0.0
    rby3: float = 0.0
    rby4: float = 0.0
    rcy1: float = 0.0
    rey1: float = 0.0
    rey2: float = 0.0
    rhy1: float = 0.0
    rhy2: float = 0.0
    rvy1: float = 0.0
    rvy2: float = 0.0
    rvy3: float = 0.0
    rvy4: float = 0.0
    rvy5: float = 0.0
    rvy6: float = 0.0

    # Overturning moment [1].
    qsx1: float = 0.0
    qsx2: float = 0.0
    qsx3: float = 0.0
    qsx4: float = 0.0
    qsx5: float = 0.0
    qsx6: float = 0.0
    qsx7: float = 0.0
    qsx8: float = 0.0
    qsx9: float = 0.0
    qsx10: float = 0.0
    qsx11: float = 0.0
    qsx12: float = 0.0
    qsx13: float = 0.0
    qsx14: float = 0.0
    ppmx1: float = 0.0

    # Rolling resistance [1].
    qsy1: float = 0.0
    qsy2: float = 0.0
    qsy3: float = 0.0
    qsy4: float = 0.0
    qsy5: float = 0.0
    qsy6: float = 0.0
    qsy7: float = 1.0
    qsy8: float = 0.0

    # Aligning moment [1].
    qbz1: float = 0.0
    qbz2: float = 0.0
    qbz3: float = 0.0
    qbz4: float = 0.0
    qbz5: float = 0.0
    qbz9: float = 0.0
    qbz10: float = 0.0
    qcz1: float = 0.0
    qdz1: float = 0.0
    qdz2: float = 0.0
    qdz3: float = 0.0
    qdz4: float = 0.0
    qdz6: float = 0.0
    qdz7: float = 0.0
    qdz8: float = 0.0
    qdz9: float = 0.0
    qdz10: float = 0.0
    qdz11: float = 0.0
    qez1: float = 0.0
    qez2: float = 0.0
    qez3: float = 0.0
    qez4: float = 0.0
    qez5: float = 0.0
    qhz1: float = 0.0
    qhz2: float = 0.0
    qhz3: float = 0.0
    qhz4: float = 0.0
    ppz1: float = 0.0
    ppz2: float = 0.0
    ssz1: float = 0.0
    ssz2: float = 0.0
    ssz3: float = 0.0
    ssz4: float = 0.0

    # Stiffness of the carcass by load and pressure (6.1, 6.2) and relaxation lengths (5.2) [1].
    pcfx1: float = 0.0
    pcfx2: float = 0.0
    pcfx3: float = 0.0
    pcfy1: float = 0.0
    pcfy2: float = 0.0
    pcfy3: float = 0.0
    ptx1: float = 0.0
    ptx2: float = 0.0
    ptx3: float = 0.0
    pty1: float = 0.0
    pty2: float = 0.0
