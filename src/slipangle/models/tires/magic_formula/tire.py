"""`MagicFormulaTire`: Magic Formula 5.2 (PAC2002), 6.1 and 6.2 from ``.tir`` files, behind the `Tire` call.

The equations are in ``mf61`` and ``mf52``, the coefficients in ``coefficients``, the choices on which codes differ in
`Conventions`. This module converts axes, checks ranges, mirrors, and links tires to files.
"""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np

from slipangle.data.readers.tir import TirFile, read_tir
from slipangle.errors import ModelWarning, ParameterError, nearest
from slipangle.fields import Checked
from slipangle.models.model import FitInfo
from slipangle.models.tires.magic_formula.axes import ASYMMETRIC, AXES, AxisSystem
from slipangle.models.tires.magic_formula.coefficients import MF52Coefficients, MF61Coefficients
from slipangle.models.tires.magic_formula.mf52 import MF52
from slipangle.models.tires.magic_formula.mf61 import MF61, RelaxationLengths
from slipangle.models.tires.magic_formula.terms import Conventions, MagicForces, is_zero, prepare
from slipangle.models.tires.magic_formula.tir import (
    Switches,
    coefficients_from,
    file_from,
    limits_from,
    switches_from,
    warn_signs,
)
from slipangle.models.tires.magic_formula.validity import ValidRange
from slipangle.models.tires.simple import KnownRange, Rolling, Tire, TireForces, practical_slip
from slipangle.ops import Scalar, is_symbolic, is_traced

Side = Literal["LEFT", "RIGHT"]
_EQUATIONS = {"5.2": MF52(), "6": MF61()}
_INPUTS = ("kappa", "alpha", "load", "camber", "friction", "pressure", "speed", "turn_slip")
_CHUNK = 4096  # samples that pass through the equations at a time: their temporaries stay in the cache


@dataclass(frozen=True, kw_only=True)
class MagicFormulaTire(Checked, Tire):
    """Magic Formula tire. [1]_, [2]_

    Parameters
    ----------
    coefficients : MF61Coefficients or MF52Coefficients
        They choose the version.
    conventions : Conventions
        Where codes differ; the book by default.
    limits : ValidRange
        Range of load, slip, camber and pressure that the coefficients are valid for.
    outside : {"error", "extrapolate"}
        Numbers outside the limits raise `ParameterError`, or are evaluated with a `ModelWarning`. Symbols and tracers
        have no values yet, so they cannot be checked: limit them in the problem they belong to.
    combined : {"weighting", "ellipse", "none"}
        Combined slip by the weighting functions of the file, by a friction ellipse (for files without their
        coefficients), or not at all.
    axes : {"ISO-W", "SAE", "adapted SAE"}
        Axis system in which the coefficients were fitted.
    side : {"LEFT", "RIGHT", ""}
        Side of the vehicle that the coefficients describe; empty where the file does not say.
    mirrored : bool
        Whether the tire is mounted on the other side.
    source : TirFile, optional
        File that the tire came from; `to_tir` changes only what changed.
    fit_info : FitInfo, optional
        How the coefficients were fitted, where they were.

    References
    ----------
    .. [1] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.3.2 (6.1); 2nd ed., 2006 (5.2).
    .. [2] I. J. M. Besselink, A. J. C. Schmeitz, H. B. Pacejka, An improved Magic Formula/Swift tyre model that can
       handle inflation pressure changes, Vehicle System Dynamics 48 (2010) S1.

    >>> from slipangle.models.tires.magic_formula.coefficients import MF61Coefficients
    >>> tire = MagicFormulaTire(coefficients=MF61Coefficients(
    ...     FNOMIN=4000, UNLOADED_RADIUS=0.31, PCX1=1.6, PDX1=1.2, PKX1=22, PCY1=1.3, PDY1=1.1, PKY1=-20, PKY2=2.0))
    >>> bool(tire.forces(0.05, 0.1, 4000.0).F_y > 0)  # to the left
    True
    """

    conditions: ClassVar[tuple[str, ...]] = ("pressure", "speed")

    coefficients: MF61Coefficients | MF52Coefficients
    conventions: Conventions = field(default_factory=Conventions)
    limits: ValidRange = field(default_factory=ValidRange)
    outside: Literal["error", "extrapolate"] = "error"
    combined: Literal["weighting", "ellipse", "none"] = "weighting"
    axes: AxisSystem = "ISO-W"
    side: Literal["LEFT", "RIGHT", ""] = ""
    mirrored: bool | None = False
    source: TirFile | None = field(default=None, repr=False, compare=False)
    fit_info: FitInfo | None = field(default=None, repr=False, compare=False)

    # ---- evaluate ----------------------------------------------------------------------------------------------

    def forces(
        self,
        slip_ratio: Scalar,
        slip_angle: Scalar,
        load: Scalar,
        *,
        camber: Scalar = 0.0,
        friction: Scalar = 1.0,
        pressure: Scalar | None = None,
        speed: Scalar | None = None,
    ) -> TireForces:
        """Forces in ISO 8855 axes with a positive slip angle giving a force to the left.

        Unless given, at the reference speed [m/s] and the pressure [Pa] of the file, without turn slip; `evaluate` has
        them all. Slip ratio is that of `slipangle.models.tires.simple.slip_ratio`, converted to the one of tire files
        (`practical_slip`).
        """
        kappa = practical_slip(slip_ratio if not isinstance(slip_ratio, (list, tuple)) else np.asarray(slip_ratio))
        return TireForces(*self._run("slipangle", kappa, slip_angle, load, camber, friction, pressure, speed)[:5])

    def forces_at(
        self,
        slip_ratio: Scalar,
        slip_angle: Scalar,
        load: Scalar,
        *,
        camber: Scalar,
        pressure: Scalar | None,
        speed: Scalar | None = None,
    ) -> TireForces:
        """`forces` at an inflation pressure [Pa] and a speed [m/s]; None is that of the file."""
        return self.forces(slip_ratio, slip_angle, load, camber=camber, pressure=pressure, speed=speed)

    def evaluate(
        self,
        slip_ratio: Scalar,
        slip_angle: Scalar,
        load: Scalar,
        *,
        axes: AxisSystem,
        camber: Scalar = 0.0,
        pressure: Scalar | None = None,
        speed: Scalar | None = None,
        turn_slip: Scalar | None = None,
        friction: Scalar = 1.0,
    ) -> MagicForces:
        """Forces, moments and what they are made of, in the axis system that you name.

        Raises ParameterError if a number is outside the limits of the tire, or the file has no coefficients for turn
        slip.

        Parameters
        ----------
        slip_ratio : scalar or array
            Longitudinal slip kappa = (omega r - v_x) / |v_x|; positive drives, in every axis system. [-]
        slip_angle : scalar or array
            Slip angle in ``axes``: a positive one gives F_y < 0 in ISO-W and SAE, F_y > 0 in adapted SAE. [rad]
        load : scalar or array
            Vertical load, positive in every axis system. [N]
        axes : {"ISO-W", "SAE", "adapted SAE"}
            ISO-W: y left, z up (TYDEX W, MF-Tyre). SAE: y right, z down. Adapted SAE: SAE with the slip angle turned
            round, as in the book.
        camber : scalar or array
            Inclination; positive leans the top to the right, in every axis system. [rad]
        pressure : scalar or array, optional
            Inflation pressure; that of the file by default. [Pa]
        speed : scalar or array, optional
            Forward speed V_cx. Left out, it is the reference speed of the file; given, the offsets and moments
            fade out below VXLOW, and a negative one rolls backwards. [m/s]
        turn_slip : scalar or array, optional
            Curvature of the wheel's path, yaw rate over speed, positive to the left in every axis system. Left out,
            turn slip is not considered and camber acts as in eqs. 4.E27 and 4.E47 of the book. [1/m]
        friction : scalar or array
            Road friction relative to the road of the test; scales LMUX and LMUY. [-]
        """
        if axes not in AXES or axes == "slipangle":
            names = ("ISO-W", "SAE", "adapted SAE")
            raise ParameterError(f"axes is {axes!r}; {nearest(str(axes), names)}: use one of these")
        return self._run(axes, slip_ratio, slip_angle, load, camber, friction, pressure, speed, turn_slip)

    def _run(self, axes: str, *given: Any) -> MagicForces:
        """Axes at the door, checks, chunks; what is not given is None."""
        inputs: dict[str, Any] = dict(zip_longest(_INPUTS, given))
        c = self.coefficients
        if inputs["pressure"] is None:
            inputs["pressure"] = c.INFLPRES if not is_zero(c.INFLPRES) else c.NOMPRES
        if inputs["turn_slip"] is not None:
            self._require_turn_slip()
        inputs = {k: v if not isinstance(v, (list, tuple)) else np.asarray(v, dtype=float) for k, v in inputs.items()}
        hand = -1.0 if self.mirrored else 1.0
        slip_sign, side_sign = (a * b for a, b in zip(AXES[axes], AXES[self.axes], strict=True))
        braking = not is_symbolic(c.PKX1) and c.PKX1 < 0
        if braking:  # the coefficients count a positive slip ratio as braking
            inputs["kappa"] = -inputs["kappa"]
        if slip_sign * hand < 0:
            inputs["alpha"] = -inputs["alpha"]
        if hand < 0:
            inputs["camber"] = -inputs["camber"]
            inputs["turn_slip"] = None if inputs["turn_slip"] is None else -inputs["turn_slip"]
        if is_symbolic(*inputs.values()) or is_traced(*inputs.values()):  # no numbers to check yet
            forces = self._equations(**inputs)
        else:
            self._check(inputs)
            forces = self._chunked(inputs)
        # the equations give M_y about the axis to the left, whatever the axes of the coefficients
        spin_sign = AXES[axes][1]
        lateral = side_sign * hand
        signs = dict.fromkeys(("F_y", "M_z", "F_y0", "M_zr", "arm"), lateral)
        signs |= {"M_x": hand, "M_y": spin_sign, "K_y": side_sign * slip_sign, "K_x": -1.0 if braking else 1.0}
        return forces._replace(
            **{name: getattr(forces, name) if s > 0 else -getattr(forces, name) for name, s in signs.items()}
        )

    def _equations(self, **inputs: Any) -> MagicForces:
        c, o = self.coefficients, self.conventions
        return self._version.forces(c, o, prepare(c, o, **inputs), combined=self.combined)

    @property
    def _version(self) -> MF61:
        """The equations of the coefficients' version."""
        return _EQUATIONS[self.coefficients.version]

    def _chunked(self, inputs: Mapping[str, Any]) -> MagicForces:
        arrays = {k: v for k, v in inputs.items() if isinstance(v, np.ndarray) and v.ndim > 0}
        shape = np.broadcast_shapes(*(v.shape for v in arrays.values())) if arrays else ()
        n = math.prod(shape)
        if n <= 2 * _CHUNK or any(v.shape != shape for v in arrays.values()):
            return self._equations(**inputs)
        flat = {k: v.reshape(n) for k, v in arrays.items()}
        fixed = {k: v for k, v in inputs.items() if k not in arrays}
        outputs = [np.empty(n) for _ in MagicForces._fields]
        for start in range(0, n, _CHUNK):
            part = slice(start, start + _CHUNK)
            forces = self._equations(**fixed, **{k: v[part] for k, v in flat.items()})
            for out, value in zip(outputs, forces, strict=True):
                out[part] = value
        return MagicForces(*(out.reshape(shape) for out in outputs))

    # ---- properties --------------------------------------------------------------------------------------------

    def relaxation_lengths(
        self, load: Scalar, *, camber: Scalar = 0.0, pressure: Scalar | None = None
    ) -> RelaxationLengths:
        """Relaxation lengths at small slip [m], at a load [N], camber [rad] and pressure [Pa], by default the file's.

        Raises ParameterError if the carcass stiffness that version 6 needs is missing.
        """
        c, dpi = self.coefficients, self._pressure_change(pressure)
        dfz = (load - c.LFZO * c.FNOMIN) / (c.LFZO * c.FNOMIN)
        return RelaxationLengths(*self._version.relaxation_lengths(c, load, dfz, dpi, camber))

    def rolling_radius(self, load: Scalar, *, speed: Scalar = 0.0, pressure: Scalar | None = None) -> Scalar:
        """Effective rolling radius: forward speed over wheel speed at zero slip. [m]"""
        return self._version.rolling_radius(self.coefficients, load, self._pressure_change(pressure), speed)

    def rolling(self, load: float) -> Rolling:
        """Radius, relaxation lengths and rolling resistance, each None where the file has no coefficients of it."""
        c = self.coefficients
        radius = float(self.rolling_radius(load, speed=c.LONGVL))
        carcass = ("LONGITUDINAL_STIFFNESS", "LATERAL_STIFFNESS")
        soft = [n for n in carcass if c.version == "6" and not getattr(c, n)]
        filled = self.with_coefficients(**dict.fromkeys(soft, 1.0)).relaxation_lengths(load)
        lengths = [float(v) if v > 0 and n not in soft else None for n, v in zip(carcass, filled, strict=True)]
        resistance = -float(self.unlimited().forces(0.0, 0.0, load).M_y) / (load * radius)
        return Rolling(radius, lengths[0], lengths[1], resistance or None)

    def _pressure_change(self, pressure: Scalar | None) -> Scalar:
        """Inflation pressure over the nominal one, minus 1; 0 where a file has none. 4.E2b"""
        c = self.coefficients
        p = c.INFLPRES if pressure is None else pressure
        return 0.0 if is_zero(c.NOMPRES) or is_zero(p) else (p - c.NOMPRES) / c.NOMPRES

    # ---- variants ----------------------------------------------------------------------------------------------

    def with_coefficients(self, **values: Any) -> Self:
        """A copy with some coefficients replaced (numbers or symbols)."""
        return replace(self, coefficients=self.coefficients.with_values(**values))

    def scaled(self, **factors: Scalar) -> Self:
        """A copy with scaling factors multiplied (numbers or symbols); raises ParameterError if there is no such."""
        given = {n: v for n, v in factors.items() if is_symbolic(v) or is_traced(v) or v != 1}
        for name in given:
            if not self.coefficients.si(name).doc.startswith("scaling"):
                raise ParameterError(f"{name} is no scaling factor; expected one, such as LMUY: use with_coefficients")
        if not given:
            return self
        return self.with_coefficients(**{n: getattr(self.coefficients, n) * v for n, v in given.items()})

    def mounted(self, side: Side) -> Self:
        """The tire on the given side of the vehicle: mirrored if its coefficients describe the other side.

        Raises ParameterError if the coefficients do not say which side they describe.
        """
        if side not in ("LEFT", "RIGHT"):
            raise ParameterError(f"side is {side!r}; expected 'LEFT' or 'RIGHT'")
        if not self.side:
            raise ParameterError(
                "the file does not say on which side the tire was measured (TYRESIDE); expected LEFT or RIGHT: "
                "name it with side='LEFT' when you read the file, or use symmetric()"
            )
        return replace(self, mirrored=side != self.side)

    def unlimited(self) -> Self:
        """A copy that is used whatever its slip and load."""
        return replace(self, limits=ValidRange(), outside="extrapolate")

    @property
    def known_range(self) -> KnownRange:
        """Limits of the file; usual are a quarter to twice the nominal load."""
        limits, default, nominal = self.limits, KnownRange(), float(self.coefficients.FNOMIN)
        return KnownRange(
            slip_ratio=min(default.slip_ratio, *(abs(v) / (1 + abs(v)) for v in limits.slip_ratio)),
            slip_angle=min(default.slip_angle, *(abs(v) for v in limits.slip_angle)),
            usual=(max(limits.load[0], 0.25 * nominal), min(limits.load[1], 2.0 * nominal)),
            limits=limits.load,
        )

    def symmetric(self) -> Self:
        """A copy without conicity, ply steer and every other difference between left and right."""
        names = set(self.coefficients.metadata())
        zero = dict.fromkeys((n for n in ASYMMETRIC if n in names), 0.0)
        if self.coefficients.version == "5.2" or self.conventions.aligning == "paper":
            zero["QDZ3"] = 0.0  # there it multiplies camber, not its absolute value
        return self.with_coefficients(**zero)

    # ---- files -------------------------------------------------------------------------------------------------

    @classmethod
    def from_tir(
        cls,
        file: str | Path | TirFile,
        *,
        conventions: Conventions | None = None,
        outside: Literal["error", "extrapolate"] = "error",
        combined: Literal["weighting", "ellipse", "none"] | None = None,
        axes: AxisSystem | None = None,
        side: Literal["LEFT", "RIGHT", ""] | None = None,
        force: bool = False,
    ) -> Self:
        """Tire of a ``.tir`` file.

        Raises MissingFileError, FormatError, UnitError if the file cannot be read, has a bad line, mixes units, lacks
        a coefficient or has one outside its range.

        Warns with ModelWarning, with what ``force`` waived, where a positive slip ratio of the coefficients brakes
        (PKX1 < 0; it is turned round), and where the cornering stiffness changes its sign with load.

        Parameters
        ----------
        file : path or TirFile
            File of FITTYP 5, 6, 21, 52 (version 5.2), 60, 61, 62 (version 6), or without (its coefficients tell).
        conventions, outside : optional
            As in the class.
        combined, axes, side : optional
            As in the class; by default what the file says (FE_METHOD, USE_MODE, AXIS_SYSTEM, TYRESIDE). Without
            coefficients of combined slip that is the ellipse; without axes ISO-W, or adapted SAE where the cornering
            stiffness K_yalpha at nominal load is positive.
        force : bool
            Use coefficients outside their range as they stand, and leave empty limits open.
        """
        tir = file if isinstance(file, TirFile) else read_tir(file)
        o = conventions or Conventions()
        given: dict[str, Any] = {"combined": combined, "axes": axes, "side": side}
        switches = switches_from(tir)._asdict() | {key: value for key, value in given.items() if value is not None}
        coefficients, limits = coefficients_from(tir, o, force=force), limits_from(tir, force=force)
        warn_signs(coefficients, _EQUATIONS[coefficients.version].cornering_stiffness, tir.name)
        return cls(coefficients=coefficients, conventions=o, limits=limits, outside=outside, source=tir, **switches)

    def to_tir(self, *, comments: Mapping[str, str] | None = None) -> TirFile:
        """The tire as a file: the one that it came from with what changed, or a new one.

        Conventions are not part of a file; pass them again when you read it. ``comments`` are new ones by coefficient,
        such as its confidence interval. Raises ParameterError if a coefficient is a symbol.
        """
        switches = Switches(self.combined, self.axes, self.side, bool(self.mirrored))
        return file_from(
            self.coefficients, source=self.source, limits=self.limits, switches=switches, comments=comments or {}
        )

    def write_tir(self, path: str | Path, *, comments: Mapping[str, str] | None = None) -> Path:
        """Write `to_tir` to a file; raises WriteError if the place cannot be written."""
        return self.to_tir(comments=comments).write(path)

    # ---- checks ------------------------------------------------------------------------------------------------

    def _check(self, inputs: Mapping[str, Any]) -> None:
        problems = self.limits.violations(inputs)
        if not problems:
            return
        if self.outside == "error":
            raise ParameterError(f"{problems[0]}: stay inside, or ask for extrapolation with outside='extrapolate'")
        warnings.warn(f"the tire is extrapolated: {'; '.join(problems)}", ModelWarning, stacklevel=4)

    def _require_turn_slip(self) -> None:
        missing = [n for n in ("PHYP1", "PHYP2", "QDRP1") if is_zero(getattr(self.coefficients, n))]
        if missing:
            raise ParameterError(
                f"turn slip needs {', '.join(missing)}, which the tire does not have; expected the section "
                "[TURNSLIP_COEFFICIENTS]: leave turn_slip out, or add them with with_coefficients"
            )
