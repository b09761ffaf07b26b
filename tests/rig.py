"""A synthetic tire rig: runs of a known tire in the layout of the Tire Test Consortium, in any axis system."""

import numpy as np
from scipy.io import savemat

from slipangle.models.tires.magic_formula.coefficients import MF61Coefficients
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire

LOADS = (222.0, 445.0, 667.0, 890.0, 1112.0)
CAMBERS = (0.0, 2.0, 4.0)  # deg
PRESSURES = (69.0, 83.0)  # kPa
LONGITUDINAL = {"PCX1": 1.6, "PDX1": 2.5, "PDX2": -0.2, "PEX1": 0.1, "PKX1": 50.0, "PKX2": -5.0, "PHX1": 0.002}
LATERAL = {"PCY1": 1.4, "PDY1": 2.4, "PDY2": -0.3, "PDY3": 2.0, "PEY1": 0.1, "PEY2": 0.1, "PKY1": -50.0, "PKY2": 1.5}
LATERAL |= {"PHY1": 0.002, "PVY1": 0.02, "PPY1": 0.2, "PKY6": -1.0}
MOMENTS = {"QBZ1": 10.0, "QCZ1": 1.1, "QDZ1": 0.12, "QDZ6": -0.003, "QBZ9": 18.0, "QSX3": 0.03, "QSX2": 0.5}
COMBINED = {"RBX1": 12.0, "RBX2": 9.0, "RCX1": 1.0, "RBY1": 12.0, "RBY2": 9.0, "RCY1": 1.0}
SIZE = {"FNOMIN": 660.0, "UNLOADED_RADIUS": 0.26, "NOMPRES": 76e3, "INFLPRES": 76e3}
TIRE = MagicFormulaTire(coefficients=MF61Coefficients(**SIZE, **LONGITUDINAL, **LATERAL, **MOMENTS, **COMBINED))


def channels(kind="cornering", *, z_down=True, opposes=True, ratio_turned=False, noise=0.01, seed=0, tire=TIRE):
    """Channels of one run: deg, km/h, kPa, N; SA sweeps of +-12 deg, or SL sweeps of +-0.3 at SA of 0, 3, 6 deg."""
    rng = np.random.default_rng(seed)
    swing = np.sin(np.linspace(0, 2 * np.pi, 240, endpoint=False))
    parts = []
    for pressure in PRESSURES:
        for camber in CAMBERS:
            for load in LOADS:
                if kind == "cornering":
                    parts.append((12.0 * swing, 0.0 * swing, load, camber, pressure))
                else:
                    parts += [(angle + 0 * swing, 0.3 * swing, load, camber, pressure) for angle in (0.0, 3.0, 6.0)]
    alpha, kappa, load, camber, pressure = (
        np.concatenate([np.broadcast_to(p[k], 240) for p in parts]) for k in range(5)
    )
    n = len(alpha)
    load = load + 12 * rng.standard_normal(n)
    camber = camber + 0.03 * rng.standard_normal(n)
    pressure = pressure + 0.3 * rng.standard_normal(n)
    # alpha > 0 gives a force to the left here; evaluate in ISO-W, where it is the other sign
    f = tire.evaluate(kappa, -np.deg2rad(alpha), load, axes="ISO-W", camber=np.deg2rad(camber), pressure=1e3 * pressure)
    side, weight = (-1.0 if z_down else 1.0), np.abs(load)
    sa = alpha * side * (-1.0 if opposes else 1.0)
    return {
        "ET": 0.01 * np.arange(n),
        "V": 40.0 + 0.1 * rng.standard_normal(n),
        "N": np.full(n, 400.0),
        "SA": sa,
        "IA": camber,
        "P": pressure,
        "FX": f.F_x + noise * weight * rng.standard_normal(n),
        "FY": side * (f.F_y + noise * weight * rng.standard_normal(n)),
        "FZ": side * load,
        "MX": f.M_x + 0.003 * weight * rng.standard_normal(n),
        "MZ": side * (f.M_z + 0.0015 * weight * rng.standard_normal(n)),
        **({} if kind == "cornering" else {"SL": kappa * (-1.0 if ratio_turned else 1.0)}),
        "TSTC": np.full(n, 60.0),
    }


UNITS = {"ET": "sec", "V": "kph", "N": "rpm", "SA": "deg", "IA": "deg", "P": "kPa", "FX": "N", "FY": "N", "FZ": "N"}
UNITS |= {"MX": "N-m", "MZ": "N-m", "SL": "none", "TSTC": "deg C"}
_POUNDS = {"V": ("mph", 1 / 1.609344), "P": ("psi", 1 / 6.894757293168)}
_POUNDS |= {k: ("lb", 1 / 4.4482216152605) for k in ("FX", "FY", "FZ")}
_POUNDS |= {k: ("ft-lb", 1 / 1.3558179483314) for k in ("MX", "MZ")}


def pounds(columns):
    """The same channels in pounds, miles and inches, with their units."""
    units = {k: _POUNDS.get(k, (UNITS[k], 1.0))[0] for k in columns}
    return {k: v * _POUNDS.get(k, ("", 1.0))[1] for k, v in columns.items()}, units


def write_mat(path, columns, units=None):
    """One variable per channel, and a struct that names units where they are given."""
    content = {k: v[:, None] for k, v in columns.items()} | {"source": "synthetic", "tireid": "synthetic tire"}
    if units:
        content["channel"] = {
            "name": np.array(list(columns), dtype=object),
            "units": np.array([units[k] for k in columns], dtype=object),
        }
    savemat(path, content)


def write_dat(path, columns, units=UNITS):
    """Title, channel names, units, numbers; tabs between."""
    lines = ["synthetic run 1", "\t".join(columns)]
    if units:
        lines.append("\t".join(units[k] for k in columns))
    lines += ["\t".join(f"{v:.8g}" for v in row) for row in np.column_stack(list(columns.values()))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


_TYDEX = {"ET": "RUNTIME", "V": "TRAJVELW", "SA": "SLIPANGL", "SL": "LONGSLIP", "IA": "INCLANGL", "P": "INFLPRES"}
_TYDEX |= {"FX": "FXW", "FY": "FYW", "FZ": "FZW", "MX": "MXW", "MZ": "MZW"}
_TYDEX_UNITS = {"RUNTIME": ("s", 1.0), "TRAJVELW": ("m/s", 1 / 3.6), "LONGSLIP": ("%", 100.0)}
_TYDEX_UNITS |= {"INFLPRES": ("bar", 0.01)}
_TYDEX_UNITS |= {"SLIPANGL": ("deg", 1.0), "INCLANGL": ("deg", 1.0), "MXW": ("Nm", 1.0), "MZW": ("Nm", 1.0)}


def write_tydex(path, columns, factors=None, pressure=None):
    """A TYDEX measurement of channels in metric units and ISO axes; a pressure [bar] makes it a constant."""
    names = [c for c in _TYDEX if c in columns and not (c == "P" and pressure is not None)]
    lines = ["**HEADER", "RELEASE   Release of TYDEX-Format                           1.3", "**COMMENTS", "synthetic"]
    lines += ["**CONSTANTS"]
    if pressure is not None:
        lines += [f"{'INFLPRES':<10}{'Inflation pressure':<30}{'bar':<10}{pressure:<10g}"]
    lines += ["**MEASURCHANNELS", "! name, description, unit, factor, offsets"]
    stored = []
    for name in names:
        key = _TYDEX[name]
        unit, scale = _TYDEX_UNITS.get(key, ("N", 1.0))
        factor, before, behind = (factors or {}).get(key, (1.0, 0.0, 0.0))
        stored.append((columns[name] * scale - behind) / factor - before)
        lines.append(f"{key:<10}{'what it is, in words':<30}{unit:<10}{factor:<10g}{before:<10g}{behind:<10g}")
    lines.append("**MEASURDATA")
    lines += [" ".join(f"{v:.8g}" for v in row) for row in np.column_stack(stored)]
    path.write_text("\n".join([*lines, "**END"]) + "\n", encoding="utf-8")
