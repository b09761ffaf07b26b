"""Explicit integrators as C, once for all that step in compiled code: one number, vectors of them, any rates."""

from __future__ import annotations

from typing import Literal

_EULER = """\
    {first};
    for (long i = 0; i < {n}; i++) {out}[i] = x[i] + {h} * sum[i];
    (void)y, (void)k;"""
_RK4 = """\
    {first};
    for (long i = 0; i < {n}; i++) y[i] = x[i] + {half} * sum[i];
    {later};
    for (long i = 0; i < {n}; i++) {{ sum[i] += 2.0 * k[i]; y[i] = x[i] + {half} * k[i]; }}
    {later};
    for (long i = 0; i < {n}; i++) {{ sum[i] += 2.0 * k[i]; y[i] = x[i] + {h} * k[i]; }}
    {later};
    for (long i = 0; i < {n}; i++) {out}[i] = x[i] + {sixth} * (sum[i] + k[i]);"""


def explicit_step(method: Literal["euler", "rk4"], rates: str, *, n: int | str, h: float | str, out: str) -> str:
    """C statements of one step from ``x`` to ``out``, which may be ``x``; ``y``, ``k`` and ``sum`` are to work in.

    ``rates`` is the call that evaluates the rates, with ``{x}`` for where it reads the state and ``{k}`` for where it
    writes; ``n`` numbers in each array, and the length ``h`` of the step [s], are numbers or C expressions.
    """
    lengths = (h, f"0.5 * {h}", f"{h} / 6.0") if isinstance(h, str) else (float.hex(v) for v in (h, h / 2, h / 6))
    first, later = rates.format(x="x", k="sum"), rates.format(x="y", k="k")
    whole, half, sixth = lengths
    template = _RK4 if method == "rk4" else _EULER
    return template.format(n=n, out=out, first=first, later=later, h=whole, half=half, sixth=sixth)
