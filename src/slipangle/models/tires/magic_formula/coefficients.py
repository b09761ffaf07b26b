"""Coefficients of the Magic Formula, named as in ``.tir`` files, with unit, meaning and range.

One without a default must be given. The others default to what leaves the equations without that effect: 0 for
coefficients, 1 for scaling factors, 2 for PKY4, which turns the load curve of 6.1 into that of 5.2.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

from slipangle.models.parameters import ParameterSet, require_in_range
from slipangle.units import SI

# A line has a coefficient and its meaning; or the words that several meanings begin with, " : " and how they go on,
# where one without a name of its own has the next number. In brackets are unit and range; * marks what must be given, =
# another default than 0, or than 1 of scalings, which range from 0 to 100.
_COMMON = """
# model and size
FNOMIN* nominal load F_z0 [N, 1 to 1e7]
UNLOADED_RADIUS* unloaded radius R_0 [m, 0.01 to 5]
LONGVL=16.7 reference speed V_0 [m/s, 0.1 to 200]
VXLOW=1 speed below which offsets and moments fade out [m/s, 0 to 50]
WIDTH=0.2 section width [m, 0 to 5]
RIM_RADIUS rim radius [m, 0 to 5]
INFLPRES inflation pressure [Pa, 0 to 1e7]
NOMPRES nominal inflation pressure p_i0; 0: pressure has no influence [Pa, 0 to 1e7]
VERTICAL_STIFFNESS vertical stiffness c_z0 [N/m, 0 to 1e8]
BREFF rolling radius, : slope at low load | DREFF peak | FREFF slope at high load
# scaling
LFZO scaling of the : nominal load [-, 0.01 to 100]
LCX scaling of the : shape factor of F_x | LMUX peak friction of F_x | LEX curvature of F_x
LKX scaling of the : slip stiffness | LHX horizontal shift of F_x | LVX vertical shift of F_x
LCY scaling of the : shape factor of F_y | LMUY peak friction of F_y | LEY curvature of F_y
LKY scaling of the : cornering stiffness | LHY horizontal shift of F_y | LVY vertical shift of F_y
LTR scaling of the : pneumatic trail | LRES residual moment | LXAL influence of slip angle on F_x
LYKA scaling of the : influence of slip ratio on F_y | LVYKA side force induced by slip ratio
LS scaling of the : moment arm of F_x | LMX overturning moment | LVMX offset of the overturning moment
LMY scaling of the : rolling resistance | LMP parking moment
# longitudinal force
PCX1* shape factor of F_x [-, 0 to 10]
PDX1* peak friction : at nominal load | with load | with camber squared [1/rad2]
PEX1 curvature : at nominal load | with load | with load squared | , driving against braking
PKX1* slip stiffness : over load, at nominal load | with load | , exponent of load
PHX1 horizontal shift : at nominal load | with load
PVX1 vertical shift : over load, at nominal load | with load
PPX1 slip stiffness with pressure : | squared
PPX3 peak friction with pressure : | squared
RBX1 combined slip, : slope | slope with slip ratio | RCX1 shape factor
REX1 combined slip, : curvature | curvature with load | RHX1 shift
# lateral force
PCY1* shape factor of F_y [-, 0 to 10]
PDY1* peak friction : at nominal load | with load | with camber squared [1/rad2]
PEY1 curvature : at nominal load | with load | , left against right | with camber [1/rad]
PKY1* largest cornering stiffness over nominal load [1/rad]
PKY2* load of the largest cornering stiffness over nominal load
PKY3 cornering stiffness with camber [1/rad]
PHY1 horizontal shift : at nominal load [rad] | with load [rad]
PVY1 vertical shift : over load, at nominal load | with load | with camber [1/rad] | with camber and load [1/rad]
PPY1 cornering stiffness with pressure | load of the largest cornering stiffness with pressure
PPY3 peak friction with pressure : | squared
RBY1 combined slip, : slope | slope with slip angle | slip angle of the largest slope | RCY1 shape factor
REY1 combined slip, : curvature | curvature with load | RHY1 shift | shift with load
RVY1 side force induced by slip ratio, : at nominal load | with load | with camber [1/rad]
RVY4 side force induced by slip ratio, : with slip angle | shape | slope
# overturning moment
QSX1 offset | with camber [1/rad] | with side force
QSX4 amplitude of the load-dependent part | shape of the load-dependent part | slope of the load-dependent part
QSX7 load-dependent part with : camber | side force, shape | side force, slope
QSX10 camber with load, : amplitude [1/rad] | slope
PPMX1 camber with pressure
# rolling resistance
QSY1 rolling resistance | with longitudinal force | with speed | with the fourth power of speed
QSY5 with : camber squared [1/rad2] | load and camber squared [1/rad2]
QSY7 exponent of : load | pressure
# aligning moment
QBZ1 trail slope : at nominal load | with load
QBZ3 trail slope : with load squared | with camber [1/rad] | with absolute camber [1/rad]
QBZ9 residual moment, slope : | with cornering stiffness
QCZ1 trail shape factor [-, 0 to 10]
QDZ1 trail peak : at nominal load | with load | with camber [1/rad] | with camber squared [1/rad2]
QDZ6 residual moment : at nominal load | with load | with camber [1/rad] | with camber and load [1/rad]
QEZ1 trail curvature : at nominal load | with load | with load squared | , left against right | with camber [1/rad]
QHZ1 trail shift : at nominal load [rad] | with load [rad] | with camber | with camber and load
PPZ1 trail with pressure | residual moment with pressure
SSZ1 moment arm of F_x : at nominal load | with side force | with camber [1/rad] | with camber and load [1/rad]
# turn slip
PDXP1 peak of F_x with spin : | and load | and slip ratio
PKYP1 cornering stiffness with spin
PDYP1 peak of F_y with : spin | spin and load | spin and slip angle | the root of spin
PHYP1 shift of F_y by spin, : shape factor | peak | peak with load | curvature
PECP1 camber against turn slip : | , with load
QDTP1 trail with spin
QCRP1 turning moment : at standstill | with spin at 90 degrees of slip angle
QBRP1 residual moment with spin
QDRP1 turning moment, shape factor
"""
_ONLY_6 = """
PEY5 curvature with camber squared [1/rad2]
PKY4=2 shape of cornering stiffness over load
PKY5 load of the largest cornering stiffness with camber squared [1/rad2]
PKY6 camber stiffness : over load [1/rad] | with load [1/rad]
PPY5 camber stiffness with pressure
RBX3 combined slip of F_x, slope with camber squared [1/rad2]
RBY4 combined slip of F_y, slope with camber squared [1/rad2]
QSX12 overturning with : camber times absolute camber [1/rad2]
QSX13 overturning with : side force, load not counted | side force and absolute camber [1/rad]
QDZ10 residual moment with camber squared : [1/rad2] | and load [1/rad2]
LKYC scaling of the : camber stiffness | LKZC camber moment | LMUV=0 decay of friction with slip speed
Q_RE0=1 ratio of the unloaded radii, rolling and standing [-, 0.5 to 2]
Q_V1 radius with speed squared
PFZ1 vertical stiffness with pressure
LONGITUDINAL_STIFFNESS longitudinal carcass stiffness c_x0 [N/m, 0 to 1e8]
LATERAL_STIFFNESS lateral carcass stiffness c_y0 [N/m, 0 to 1e8]
PCFX1 c_x with : load | load squared | pressure
PCFY1 c_y with : load | load squared | pressure
"""
_ONLY_5 = """
PHY3 horizontal shift of F_y with camber
PTX1 longitudinal relaxation length : at nominal load | with load | , exponent of load
PTY1 largest lateral relaxation length over radius
PTY2 load of the largest lateral relaxation length over nominal load
LGAX scaling of : camber for F_x | LGAY camber for F_y | LGAZ camber for M_z
LKYG scaling of the : camber stiffness | LSGKP longitudinal relaxation length | LSGAL lateral relaxation length
LCZ scaling of the : vertical stiffness
"""
_PART = re.compile(r"(?:([A-Z][A-Z_\d]+(?:\*|=\S+)?)(?:\s+|$))?(.*?)\s*(?:\[([^,]*)(?:, (\S+) to (\S+))?\])?")
T = TypeVar("T", bound=type)


def _entries(table: str) -> Iterator[tuple[str, SI, float | None]]:
    """Name, meaning and default of each coefficient; None where it must be given."""
    for line in table.split("\n"):
        first, _, rest = line.partition(" ")
        stem, _, parts = rest.rpartition(" : ")
        label = first
        for i, part in enumerate(parts.split("|") if first not in ("", "#") else ()):
            own, words, unit, low, high = re.fullmatch(_PART, part.strip()).groups()  # type: ignore[union-attr]
            following = re.sub(r"\d+", lambda digits: str(int(digits[0]) + 1), label.rstrip("*"))
            label = own or (label if i == 0 else following)
            meaning = f"{stem} {words}".strip().replace(" ,", ",")
            usual, span = (1.0, (0.0, 100.0)) if meaning.startswith("scaling") else (0.0, (-inf, inf))
            name, _, default = label.rstrip("*").partition("=")
            lower, upper = span if low is None else (float(low), float(high))
            yield name, SI(unit or "-", meaning, lower, upper), None if "*" in label else float(default or usual)


def _with(table: str) -> Callable[[T], T]:
    """A parameter record with the coefficients of a table as fields."""

    def build(cls: T) -> T:
        types = dict(cls.__annotations__)
        for name, meaning, default in _entries(table):
            types[name] = Annotated[float, meaning]
            if default is not None:
                setattr(cls, name, default)
        cls.__annotations__ = types
        return dataclass(frozen=True, kw_only=True)(cls)

    return build


@_with(_COMMON)
class MagicCoefficients(ParameterSet):
    """What versions 5.2 and 6.x have in common; see `MF61Coefficients` and `MF52Coefficients`."""

    version: ClassVar[str]  # of the Magic Formula, "5.2" or "6"
    fit_type: ClassVar[int]  # FITTYP of a file
    waived: tuple[str, ...] = ()  # coefficients that may leave their range

    if TYPE_CHECKING:

        def __init__(self, **values: Any) -> None: ...

        def __getattr__(self, name: str) -> Any: ...

    def __post_init__(self) -> None:
        for name, meta in self.metadata().items():
            if name not in self.waived:
                require_in_range(f"{type(self).__name__}.{name} ({meta.doc})", getattr(self, name), meta)


@_with(_ONLY_6)
class MF61Coefficients(MagicCoefficients):
    """Coefficients of Magic Formula 6.0, 6.1 and 6.2 (FITTYP 60, 61, 62). [1]_, [2]_

    References
    ----------
    .. [1] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.3.2 and appendix 3.
    .. [2] I. J. M. Besselink, A. J. C. Schmeitz, H. B. Pacejka, An improved Magic Formula/Swift tyre model that can
       handle inflation pressure changes, Vehicle System Dynamics 48 (2010) S1.
    """

    version: ClassVar[str] = "6"
    fit_type: ClassVar[int] = 61


@_with(_ONLY_5)
class MF52Coefficients(MagicCoefficients):
    """Coefficients of Magic Formula 5.0 to 5.2 and PAC2002 (FITTYP 5, 6, 21, 52 or absent).

    Source: H. B. Pacejka, Tyre and Vehicle Dynamics, 2nd ed., 2006, sec. 4.3.2 and appendix.
    """

    version: ClassVar[str] = "5.2"
    fit_type: ClassVar[int] = 6
    LMUV = PEY5 = RBX3 = RBY4 = QDZ10 = QDZ11 = QSX12 = QSX13 = QSX14 = 0.0  # of version 6, without effect
    LKZC = 1.0
