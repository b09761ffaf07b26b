"""Elementary functions that work on numbers, CasADi symbols and JAX tracers alike.

The equations of the toolbox are written once with these; the type of the argument picks
NumPy, CasADi or ``jax.numpy``. A vector is indexed along its first axis (``x[0]``), so a NumPy
array of shape ``(n, batch)`` runs a whole batch through the same equations.
"""

import sys
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

Scalar = Any  # a number, an array of numbers, a CasADi symbol or a JAX tracer
Vector = Any  # indexable along its first axis

_CASADI = (ca.SX, ca.MX, ca.DM)
_NUMBERS = frozenset({float, int, np.float64})  # told by their type alone, as most values of a run are
_PLAIN = _NUMBERS | {np.ndarray, bool, np.bool_}


def is_symbolic(*values: object) -> bool:
    """Whether any value is a CasADi expression (DM, a CasADi number, counts too)."""
    for v in values:  # no any(): a run in Python asks this at every operation
        if type(v) not in _PLAIN and isinstance(v, _CASADI):
            return True
    return False


def is_traced(*values: object) -> bool:
    """Whether any value is a JAX tracer, which has no number yet."""
    jax = sys.modules.get("jax")
    return jax is not None and any(type(v) not in _PLAIN and isinstance(v, jax.core.Tracer) for v in values)


def _is_jax(*values: object) -> bool:
    jax = sys.modules.get("jax")
    return jax is not None and any(type(v) not in _PLAIN and isinstance(v, jax.Array) for v in values)


def _numeric(*values: object) -> Any:
    """The array module for values that are not CasADi's."""
    return sys.modules["jax.numpy"] if _is_jax(*values) else np


def _unary(name: str, casadi_name: str | None = None) -> Any:
    symbolic, plain = getattr(ca, casadi_name or name), getattr(np, name)

    def apply(x: Scalar) -> Scalar:
        if type(x) in _PLAIN:
            return plain(x)
        if isinstance(x, _CASADI):
            return symbolic(x)
        return getattr(_numeric(x), name)(x)

    apply.__name__ = name
    apply.__doc__ = f"Elementwise {name} of a number, symbol or tracer."
    return apply


sin = _unary("sin")
cos = _unary("cos")
tan = _unary("tan")
atan = _unary("arctan", "atan")
asin = _unary("arcsin", "asin")
sinh = _unary("sinh")
cosh = _unary("cosh")
tanh = _unary("tanh")
exp = _unary("exp")
log = _unary("log")
sqrt = _unary("sqrt")
fabs = _unary("abs", "fabs")
sign = _unary("sign")


def _binary(name: str, casadi_name: str) -> Any:
    symbolic, plain = getattr(ca, casadi_name), getattr(np, name)

    def apply(a: Scalar, b: Scalar) -> Scalar:
        if type(a) in _PLAIN and type(b) in _PLAIN:
            return plain(a, b)
        if is_symbolic(a, b):
            return symbolic(a, b)
        return getattr(_numeric(a, b), name)(a, b)

    apply.__name__ = name
    apply.__doc__ = f"Elementwise {name} of two numbers, symbols or tracers."
    return apply


atan2 = _binary("arctan2", "atan2")
minimum = _binary("minimum", "fmin")
maximum = _binary("maximum", "fmax")
hypot = _binary("hypot", "hypot")


def where(condition: Any, if_true: Scalar, if_false: Scalar) -> Scalar:
    """``if_true`` where the condition holds, else ``if_false``; both are always evaluated."""
    if is_symbolic(condition, if_true, if_false):
        return ca.if_else(condition, if_true, if_false)
    return _numeric(condition, if_true, if_false).where(condition, if_true, if_false)


def clip(x: Scalar, lower: Scalar, upper: Scalar) -> Scalar:
    """``x`` limited to ``[lower, upper]``."""
    return minimum(maximum(x, lower), upper)


def smooth_abs(x: Scalar, width: float) -> Scalar:
    """Smooth |x|: ``sqrt(x^2 + width^2)``, equal to ``width`` at zero."""
    return sqrt(x * x + width * width)


def speed_floor(v: Scalar, v_low: float) -> Scalar:
    """|v| above ``v_low``; below it a parabola that meets |v| smoothly and stays at least ``v_low / 2``.

    Keeps slip defined at standstill without changing it in normal driving.

    >>> float(speed_floor(-20.0, 0.5)), float(speed_floor(0.0, 0.5))
    (20.0, 0.25)
    """
    return where(fabs(v) > v_low, fabs(v), (v * v + v_low * v_low) / (2 * v_low))


def stack(values: Sequence[Scalar]) -> Vector:
    """Vector of the given scalars: a CasADi column, or an array with a new first axis."""
    if _NUMBERS.issuperset(map(type, values)):
        return np.array(values, dtype=float)
    if is_symbolic(*values):
        return ca.vertcat(*values)
    module = _numeric(*values)
    return module.stack(module.broadcast_arrays(*[module.asarray(v, dtype=float) for v in values]))


def concatenate(parts: Sequence[Vector]) -> Vector:
    """Vectors joined along their first axis."""
    if is_symbolic(*parts):
        return ca.vertcat(*parts)
    return _numeric(*parts).concatenate([np.asarray(p) if not _is_jax(p) else p for p in parts])


def matmul(a: Any, x: Vector) -> Vector:
    """Matrix times vector; ``a`` is a NumPy array or an expression."""
    if is_symbolic(a, x):
        return ca.mtimes(a if is_symbolic(a) else ca.DM(np.asarray(a)), x)
    return a @ x
