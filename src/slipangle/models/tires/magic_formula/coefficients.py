"""Coefficients of the Magic Formula, named as in ``.tir`` files; unit, meaning and range on each field.

A field without a default must be given. The others default to what leaves the equations without that
effect: 0 for coefficients, 1 for scaling factors, 2 for PKY4, which turns the load curve of 6.1 into that of 5.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from slipangle.models.parameters import ParameterSet
from slipangle.ops import Scalar
from slipangle.units import SI


@dataclass(frozen=True, kw_only=True)
class MagicCoefficients(ParameterSet):
    """What versions 5.2 and 6.x have in common; see `MF61Coefficients` and `MF52Coefficients`."""

    version: ClassVar[str]  # of the Magic Formula, "5.2" or "6"
    fit_type: ClassVar[int]  # FITTYP of a file

    @property
    def slip_decay(self) -> Scalar:
        """LMUV, decay of friction with slip speed, which version 5.2 does not have. [-]"""
        return 0.0

    # model and size
    FNOMIN: Annotated[float, SI("N", "nominal load F_z0", 1.0, 1e7)]
    UNLOADED_RADIUS: Annotated[float, SI("m", "unloaded radius R_0", 0.01, 5.0)]
    LONGVL: Annotated[float, SI("m/s", "reference speed V_0", 0.1, 200.0)] = 16.7
    VXLOW: Annotated[float, SI("m/s", "speed below which offsets and moments fade out", 0.0, 50.0)] = 1.0
    WIDTH: Annotated[float, SI("m", "section width", 0.0, 5.0)] = 0.2
    RIM_RADIUS: Annotated[float, SI("m", "rim radius", 0.0, 5.0)] = 0.0
    INFLPRES: Annotated[float, SI("Pa", "inflation pressure", 0.0, 1e7)] = 0.0
    NOMPRES: Annotated[float, SI("Pa", "nominal inflation pressure p_i0; 0: pressure has no influence", 0.0, 1e7)] = 0.0
    VERTICAL_STIFFNESS: Annotated[float, SI("N/m", "vertical stiffness c_z0", 0.0, 1e8)] = 0.0
    BREFF: Annotated[float, SI("-", "rolling radius, slope at low load")] = 0.0
    DREFF: Annotated[float, SI("-", "rolling radius, peak")] = 0.0
    FREFF: Annotated[float, SI("-", "rolling radius, slope at high load")] = 0.0
    # scaling
    LFZO: Annotated[float, SI("-", "scaling of the nominal load", 0.0, 100.0)] = 1.0
    LCX: Annotated[float, SI("-", "scaling of the shape factor of F_x", 0.0, 100.0)] = 1.0
    LMUX: Annotated[float, SI("-", "scaling of the peak friction of F_x", 0.0, 100.0)] = 1.0
    LEX: Annotated[float, SI("-", "scaling of the curvature of F_x", 0.0, 100.0)] = 1.0
    LKX: Annotated[float, SI("-", "scaling of the slip stiffness", 0.0, 100.0)] = 1.0
    LHX: Annotated[float, SI("-", "scaling of the horizontal shift of F_x", 0.0, 100.0)] = 1.0
    LVX: Annotated[float, SI("-", "scaling of the vertical shift of F_x", 0.0, 100.0)] = 1.0
    LCY: Annotated[float, SI("-", "scaling of the shape factor of F_y", 0.0, 100.0)] = 1.0
    LMUY: Annotated[float, SI("-", "scaling of the peak friction of F_y", 0.0, 100.0)] = 1.0
    LEY: Annotated[float, SI("-", "scaling of the curvature of F_y", 0.0, 100.0)] = 1.0
    LKY: Annotated[float, SI("-", "scaling of the cornering stiffness", 0.0, 100.0)] = 1.0
    LHY: Annotated[float, SI("-", "scaling of the horizontal shift of F_y", 0.0, 100.0)] = 1.0
    LVY: Annotated[float, SI("-", "scaling of the vertical shift of F_y", 0.0, 100.0)] = 1.0
    LTR: Annotated[float, SI("-", "scaling of the pneumatic trail", 0.0, 100.0)] = 1.0
    LRES: Annotated[float, SI("-", "scaling of the residual moment", 0.0, 100.0)] = 1.0
    LXAL: Annotated[float, SI("-", "scaling of the influence of slip angle on F_x", 0.0, 100.0)] = 1.0
    LYKA: Annotated[float, SI("-", "scaling of the influence of slip ratio on F_y", 0.0, 100.0)] = 1.0
    LVYKA: Annotated[float, SI("-", "scaling of the side force induced by slip ratio", 0.0, 100.0)] = 1.0
    LS: Annotated[float, SI("-", "scaling of the moment arm of F_x", 0.0, 100.0)] = 1.0
    LMX: Annotated[float, SI("-", "scaling of the overturning moment", 0.0, 100.0)] = 1.0
    LVMX: Annotated[float, SI("-", "scaling of the offset of the overturning moment", 0.0, 100.0)] = 1.0
    LMY: Annotated[float, SI("-", "scaling of the rolling resistance", 0.0, 100.0)] = 1.0
    LMP: Annotated[float, SI("-", "scaling of the parking moment", 0.0, 100.0)] = 1.0
    # longitudinal force
    PCX1: Annotated[float, SI("-", "shape factor of F_x", 0.0, 10.0)]
    PDX1: Annotated[float, SI("-", "peak friction at nominal load")]
    PDX2: Annotated[float, SI("-", "peak friction with load")] = 0.0
    PDX3: Annotated[float, SI("1/rad2", "peak friction with camber squared")] = 0.0
    PEX1: Annotated[float, SI("-", "curvature at nominal load")] = 0.0
    PEX2: Annotated[float, SI("-", "curvature with load")] = 0.0
    PEX3: Annotated[float, SI("-", "curvature with load squared")] = 0.0
    PEX4: Annotated[float, SI("-", "curvature, driving against braking")] = 0.0
    PKX1: Annotated[float, SI("-", "slip stiffness over load, at nominal load")]
    PKX2: Annotated[float, SI("-", "slip stiffness with load")] = 0.0
    PKX3: Annotated[float, SI("-", "slip stiffness, exponent of load")] = 0.0
    PHX1: Annotated[float, SI("-", "horizontal shift at nominal load")] = 0.0
    PHX2: Annotated[float, SI("-", "horizontal shift with load")] = 0.0
    PVX1: Annotated[float, SI("-", "vertical shift over load, at nominal load")] = 0.0
    PVX2: Annotated[float, SI("-", "vertical shift with load")] = 0.0
    PPX1: Annotated[float, SI("-", "slip stiffness with pressure")] = 0.0
    PPX2: Annotated[float, SI("-", "slip stiffness with pressure squared")] = 0.0
    PPX3: Annotated[float, SI("-", "peak friction with pressure")] = 0.0
    PPX4: Annotated[float, SI("-", "peak friction with pressure squared")] = 0.0
    RBX1: Annotated[float, SI("-", "combined slip, slope")] = 0.0
    RBX2: Annotated[float, SI("-", "combined slip, slope with slip ratio")] = 0.0
    RCX1: Annotated[float, SI("-", "combined slip, shape factor")] = 0.0
    REX1: Annotated[float, SI("-", "combined slip, curvature")] = 0.0
    REX2: Annotated[float, SI("-", "combined slip, curvature with load")] = 0.0
    RHX1: Annotated[float, SI("-", "combined slip, shift")] = 0.0
    # lateral force
    PCY1: Annotated[float, SI("-", "shape factor of F_y", 0.0, 10.0)]
    PDY1: Annotated[float, SI("-", "peak friction at nominal load")]
    PDY2: Annotated[float, SI("-", "peak friction with load")] = 0.0
    PDY3: Annotated[float, SI("1/rad2", "peak friction with camber squared")] = 0.0
    PEY1: Annotated[float, SI("-", "curvature at nominal load")] = 0.0
    PEY2: Annotated[float, SI("-", "curvature with load")] = 0.0
    PEY3: Annotated[float, SI("-", "curvature, left against right")] = 0.0
    PEY4: Annotated[float, SI("1/rad", "curvature with camber")] = 0.0
    PKY1: Annotated[float, SI("1/rad", "largest cornering stiffness over nominal load")]
    PKY2: Annotated[float, SI("-", "load of the largest cornering stiffness over nominal load")]
    PKY3: Annotated[float, SI("1/rad", "cornering stiffness with camber")] = 0.0
    PHY1: Annotated[float, SI("rad", "horizontal shift at nominal load")] = 0.0
    PHY2: Annotated[float, SI("rad", "horizontal shift with load")] = 0.0
    PVY1: Annotated[float, SI("-", "vertical shift over load, at nominal load")] = 0.0
    PVY2: Annotated[float, SI("-", "vertical shift with load")] = 0.0
    PVY3: Annotated[float, SI("1/rad", "vertical shift with camber")] = 0.0
    PVY4: Annotated[float, SI("1/rad", "vertical shift with camber and load")] = 0.0
    PPY1: Annotated[float, SI("-", "cornering stiffness with pressure")] = 0.0
    PPY2: Annotated[float, SI("-", "load of the largest cornering stiffness with pressure")] = 0.0
    PPY3: Annotated[float, SI("-", "peak friction with pressure")] = 0.0
    PPY4: Annotated[float, SI("-", "peak friction with pressure squared")] = 0.0
    RBY1: Annotated[float, SI("-", "combined slip, slope")] = 0.0
    RBY2: Annotated[float, SI("-", "combined slip, slope with slip angle")] = 0.0
    RBY3: Annotated[float, SI("-", "combined slip, slip angle of the largest slope")] = 0.0
    RCY1: Annotated[float, SI("-", "combined slip, shape factor")] = 0.0
    REY1: Annotated[float, SI("-", "combined slip, curvature")] = 0.0
    REY2: Annotated[float, SI("-", "combined slip, curvature with load")] = 0.0
    RHY1: Annotated[float, SI("-", "combined slip, shift")] = 0.0
    RHY2: Annotated[float, SI("-", "combined slip, shift with load")] = 0.0
    RVY1: Annotated[float, SI("-", "side force induced by slip ratio, at nominal load")] = 0.0
    RVY2: Annotated[float, SI("-", "side force induced by slip ratio, with load")] = 0.0
    RVY3: Annotated[float, SI("1/rad", "side force induced by slip ratio, with camber")] = 0.0
    RVY4: Annotated[float, SI("-", "side force induced by slip ratio, with slip angle")] = 0.0
    RVY5: Annotated[float, SI("-", "side force induced by slip ratio, shape")] = 0.0
    RVY6: Annotated[float, SI("-", "side force induced by slip ratio, slope")] = 0.0
    # overturning moment
    QSX1: Annotated[float, SI("-", "offset")] = 0.0
    QSX2: Annotated[float, SI("1/rad", "with camber")] = 0.0
    QSX3: Annotated[float, SI("-", "with side force")] = 0.0
    QSX4: Annotated[float, SI("-", "amplitude of the load-dependent part")] = 0.0
    QSX5: Annotated[float, SI("-", "shape of the load-dependent part")] = 0.0
    QSX6: Annotated[float, SI("-", "slope of the load-dependent part")] = 0.0
    QSX7: Annotated[float, SI("-", "load-dependent part with camber")] = 0.0
    QSX8: Annotated[float, SI("-", "load-dependent part with side force, shape")] = 0.0
    QSX9: Annotated[float, SI("-", "load-dependent part with side force, slope")] = 0.0
    QSX10: Annotated[float, SI("1/rad", "camber with load, amplitude")] = 0.0
    QSX11: Annotated[float, SI("-", "camber with load, slope")] = 0.0
    PPMX1: Annotated[float, SI("-", "camber with pressure")] = 0.0
    # rolling resistance
    QSY1: Annotated[float, SI("-", "rolling resistance")] = 0.0
    QSY2: Annotated[float, SI("-", "with longitudinal force")] = 0.0
    QSY3: Annotated[float, SI("-", "with speed")] = 0.0
    QSY4: Annotated[float, SI("-", "with the fourth power of speed")] = 0.0
    QSY5: Annotated[float, SI("1/rad2", "with camber squared")] = 0.0
    QSY6: Annotated[float, SI("1/rad2", "with load and camber squared")] = 0.0
    QSY7: Annotated[float, SI("-", "exponent of load")] = 0.0
    QSY8: Annotated[float, SI("-", "exponent of pressure")] = 0.0
    # aligning moment
    QBZ1: Annotated[float, SI("-", "trail slope at nominal load")] = 0.0
    QBZ2: Annotated[float, SI("-", "trail slope with load")] = 0.0
    QBZ3: Annotated[float, SI("-", "trail slope with load squared")] = 0.0
    QBZ4: Annotated[float, SI("1/rad", "trail slope with camber")] = 0.0
    QBZ5: Annotated[float, SI("1/rad", "trail slope with absolute camber")] = 0.0
    QBZ9: Annotated[float, SI("-", "residual moment, slope")] = 0.0
    QBZ10: Annotated[float, SI("-", "residual moment, slope with cornering stiffness")] = 0.0
    QCZ1: Annotated[float, SI("-", "trail shape factor", 0.0, 10.0)] = 0.0
    QDZ1: Annotated[float, SI("-", "trail peak at nominal load")] = 0.0
    QDZ2: Annotated[float, SI("-", "trail peak with load")] = 0.0
    QDZ3: Annotated[float, SI("1/rad", "trail peak with camber")] = 0.0
    QDZ4: Annotated[float, SI("1/rad2", "trail peak with camber squared")] = 0.0
    QDZ6: Annotated[float, SI("-", "residual moment at nominal load")] = 0.0
    QDZ7: Annotated[float, SI("-", "residual moment with load")] = 0.0
    QDZ8: Annotated[float, SI("1/rad", "residual moment with camber")] = 0.0
    QDZ9: Annotated[float, SI("1/rad", "residual moment with camber and load")] = 0.0
    QEZ1: Annotated[float, SI("-", "trail curvature at nominal load")] = 0.0
    QEZ2: Annotated[float, SI("-", "trail curvature with load")] = 0.0
    QEZ3: Annotated[float, SI("-", "trail curvature with load squared")] = 0.0
    QEZ4: Annotated[float, SI("-", "trail curvature, left against right")] = 0.0
    QEZ5: Annotated[float, SI("1/rad", "trail curvature with camber")] = 0.0
    QHZ1: Annotated[float, SI("rad", "trail shift at nominal load")] = 0.0
    QHZ2: Annotated[float, SI("rad", "trail shift with load")] = 0.0
    QHZ3: Annotated[float, SI("-", "trail shift with camber")] = 0.0
    QHZ4: Annotated[float, SI("-", "trail shift with camber and load")] = 0.0
    PPZ1: Annotated[float, SI("-", "trail with pressure")] = 0.0
    PPZ2: Annotated[float, SI("-", "residual moment with pressure")] = 0.0
    SSZ1: Annotated[float, SI("-", "moment arm of F_x at nominal load")] = 0.0
    SSZ2: Annotated[float, SI("-", "moment arm of F_x with side force")] = 0.0
    SSZ3: Annotated[float, SI("1/rad", "moment arm of F_x with camber")] = 0.0
    SSZ4: Annotated[float, SI("1/rad", "moment arm of F_x with camber and load")] = 0.0
    # turn slip
    PDXP1: Annotated[float, SI("-", "peak of F_x with spin")] = 0.0
    PDXP2: Annotated[float, SI("-", "peak of F_x with spin and load")] = 0.0
    PDXP3: Annotated[float, SI("-", "peak of F_x with spin and slip ratio")] = 0.0
    PKYP1: Annotated[float, SI("-", "cornering stiffness with spin")] = 0.0
    PDYP1: Annotated[float, SI("-", "peak of F_y with spin")] = 0.0
    PDYP2: Annotated[float, SI("-", "peak of F_y with spin and load")] = 0.0
    PDYP3: Annotated[float, SI("-", "peak of F_y with spin and slip angle")] = 0.0
    PDYP4: Annotated[float, SI("-", "peak of F_y with the root of spin")] = 0.0
    PHYP1: Annotated[float, SI("-", "shift of F_y by spin, shape factor")] = 0.0
    PHYP2: Annotated[float, SI("-", "shift of F_y by spin, peak")] = 0.0
    PHYP3: Annotated[float, SI("-", "shift of F_y by spin, peak with load")] = 0.0
    PHYP4: Annotated[float, SI("-", "shift of F_y by spin, curvature")] = 0.0
    PECP1: Annotated[float, SI("-", "camber against turn slip")] = 0.0
    PECP2: Annotated[float, SI("-", "camber against turn slip, with load")] = 0.0
    QDTP1: Annotated[float, SI("-", "trail with spin")] = 0.0
    QCRP1: Annotated[float, SI("-", "turning moment at standstill")] = 0.0
    QCRP2: Annotated[float, SI("-", "turning moment with spin at 90 degrees of slip angle")] = 0.0
    QBRP1: Annotated[float, SI("-", "residual moment with spin")] = 0.0
    QDRP1: Annotated[float, SI("-", "turning moment, shape factor")] = 0.0


@dataclass(frozen=True, kw_only=True)
class MF61Coefficients(MagicCoefficients):
    """Coefficients of Magic Formula 6.0, 6.1 and 6.2 (FITTYP 60, 61, 62). [1]_, [2]_

    References
    ----------
    .. [1] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.3.2 and appendix 3.
    .. [2] I. J. M. Besselink, A. J. C. Schmeitz, H. B. Pacejka, An improved Magic Formula/Swift tyre model that can
       handle inflation pressure changes, Vehicle System Dynamics 48 (2010) S1.
    """

    version = "6"
    fit_type = 61
    PEY5: Annotated[float, SI("1/rad2", "curvature with camber squared")] = 0.0
    PKY4: Annotated[float, SI("-", "shape of cornering stiffness over load")] = 2.0
    PKY5: Annotated[float, SI("1/rad2", "load of the largest cornering stiffness with camber squared")] = 0.0
    PKY6: Annotated[float, SI("1/rad", "camber stiffness over load")] = 0.0
    PKY7: Annotated[float, SI("1/rad", "camber stiffness with load")] = 0.0
    PPY5: Annotated[float, SI("-", "camber stiffness with pressure")] = 0.0
    RBX3: Annotated[float, SI("1/rad2", "combined slip of F_x, slope with camber squared")] = 0.0
    RBY4: Annotated[float, SI("1/rad2", "combined slip of F_y, slope with camber squared")] = 0.0
    QSX12: Annotated[float, SI("1/rad2", "overturning with camber times absolute camber")] = 0.0
    QSX13: Annotated[float, SI("-", "overturning with side force, load not counted")] = 0.0
    QSX14: Annotated[float, SI("1/rad", "overturning with side force and absolute camber")] = 0.0
    QDZ10: Annotated[float, SI("1/rad2", "residual moment with camber squared")] = 0.0
    QDZ11: Annotated[float, SI("1/rad2", "residual moment with camber squared and load")] = 0.0
    LKYC: Annotated[float, SI("-", "scaling of the camber stiffness", 0.0, 100.0)] = 1.0
    LKZC: Annotated[float, SI("-", "scaling of the camber moment", 0.0, 100.0)] = 1.0
    LMUV: Annotated[float, SI("-", "scaling of the decay of friction with slip speed", 0.0, 100.0)] = 0.0
    Q_RE0: Annotated[float, SI("-", "ratio of the unloaded radii, rolling and standing", 0.5, 2.0)] = 1.0
    Q_V1: Annotated[float, SI("-", "radius with speed squared")] = 0.0
    PFZ1: Annotated[float, SI("-", "vertical stiffness with pressure")] = 0.0
    LONGITUDINAL_STIFFNESS: Annotated[float, SI("N/m", "longitudinal carcass stiffness c_x0", 0.0, 1e8)] = 0.0
    LATERAL_STIFFNESS: Annotated[float, SI("N/m", "lateral carcass stiffness c_y0", 0.0, 1e8)] = 0.0
    PCFX1: Annotated[float, SI("-", "c_x with load")] = 0.0
    PCFX2: Annotated[float, SI("-", "c_x with load squared")] = 0.0
    PCFX3: Annotated[float, SI("-", "c_x with pressure")] = 0.0
    PCFY1: Annotated[float, SI("-", "c_y with load")] = 0.0
    PCFY2: Annotated[float, SI("-", "c_y with load squared")] = 0.0
    PCFY3: Annotated[float, SI("-", "c_y with pressure")] = 0.0

    @property
    def slip_decay(self) -> Scalar:
        """LMUV. [-]"""
        return self.LMUV


@dataclass(frozen=True, kw_only=True)
class MF52Coefficients(MagicCoefficients):
    """Coefficients of Magic Formula 5.0 to 5.2 and PAC2002 (FITTYP 5, 6, 21, 52 or absent). [1]_

    References
    ----------
    .. [1] H. B. Pacejka, Tyre and Vehicle Dynamics, 2nd ed., 2006, sec. 4.3.2 and appendix.
    """

    version = "5.2"
    fit_type = 6
    PHY3: Annotated[float, SI("-", "horizontal shift of F_y with camber")] = 0.0
    PTX1: Annotated[float, SI("-", "longitudinal relaxation length at nominal load")] = 0.0
    PTX2: Annotated[float, SI("-", "longitudinal relaxation length with load")] = 0.0
    PTX3: Annotated[float, SI("-", "longitudinal relaxation length, exponent of load")] = 0.0
    PTY1: Annotated[float, SI("-", "largest lateral relaxation length over radius")] = 0.0
    PTY2: Annotated[float, SI("-", "load of the largest lateral relaxation length over nominal load")] = 0.0
    LGAX: Annotated[float, SI("-", "scaling of camber for F_x", 0.0, 100.0)] = 1.0
    LGAY: Annotated[float, SI("-", "scaling of camber for F_y", 0.0, 100.0)] = 1.0
    LGAZ: Annotated[float, SI("-", "scaling of camber for M_z", 0.0, 100.0)] = 1.0
    LKYG: Annotated[float, SI("-", "scaling of the camber stiffness", 0.0, 100.0)] = 1.0
    LSGKP: Annotated[float, SI("-", "scaling of the longitudinal relaxation length", 0.0, 100.0)] = 1.0
    LSGAL: Annotated[float, SI("-", "scaling of the lateral relaxation length", 0.0, 100.0)] = 1.0
    LCZ: Annotated[float, SI("-", "scaling of the vertical stiffness", 0.0, 100.0)] = 1.0
