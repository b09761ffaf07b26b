"""Arithmetic on channels as a job writes it: ``curvature * v_x``, ``v_x > 5 and t < 200``; nothing else is run."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from slipangle.errors import FormatError, nearest, shown

_LONGEST = 500
_OPERATORS: dict[type, Callable] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
    ast.USub: np.negative,
    ast.UAdd: np.positive,
    ast.Not: np.logical_not,
    ast.And: np.logical_and,
    ast.Or: np.logical_or,
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
    ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
}


def heading(x: Any, y: Any, z: Any, w: Any) -> np.ndarray:
    """Heading from a unit quaternion, from the ground's X to the body's x, counter-clockwise, without jumps. [rad]

    Source: J. Diebel, Representing Attitude, Stanford, 2006, eq. 290 (rotation body to ground, z up).

    >>> round(float(heading(0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))), 6)
    1.570796
    """
    turned = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    if np.ndim(turned) == 0:
        return np.asarray(turned)
    known = np.isfinite(turned)
    turned[known] = np.unwrap(turned[known])
    return turned


FUNCTIONS: dict[str, tuple[Callable, int]] = {  # and how many values each takes
    **{name: (getattr(np, name), 1) for name in ("abs", "sqrt", "sin", "cos", "tan", "exp", "log", "tanh", "sign")},
    **{name: (getattr(np, f"arc{name[1:]}"), 1) for name in ("asin", "acos", "atan")},
    "atan2": (np.arctan2, 2),
    "hypot": (np.hypot, 2),
    "min": (np.minimum, 2),
    "max": (np.maximum, 2),
    "heading": (heading, 4),
}
"""What an expression may call; ``heading(x, y, z, w)`` is that of a quaternion."""


class Expression:
    """Arithmetic, comparisons and functions of channels.

    Names are those of channels or of a file's columns; one that is no plain word stands in quotes.

    Raises FormatError if the text is no such expression.

    >>> speed = Expression("'wheel speed' / 3.6 > 5 and gear >= 2")
    >>> sorted(speed.names)
    ['gear', 'wheel speed']
    >>> speed({"wheel speed": np.array([10.0, 36.0]), "gear": np.array([2.0, 2.0])})
    array([False,  True])
    """

    def __init__(self, text: str) -> None:
        self.text = text
        if len(text) > _LONGEST:
            raise FormatError(f"the expression {shown(text)} has {len(text)} letters; expected at most {_LONGEST}")
        try:
            self._tree = ast.parse(text.strip(), mode="eval").body
            for node in ast.walk(self._tree):
                self._check(node)
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            why = str(error).splitlines()[0] if str(error) else type(error).__name__
            if isinstance(error, FormatError):
                raise
            raise FormatError(
                f"{shown(text)} is no expression ({why[:80]}); expected arithmetic of channels, such as "
                "'curvature * v_x', with names that are no plain words in quotes"
            ) from None

    def _check(self, node: ast.AST) -> None:
        if isinstance(node, ast.Call):
            name = node.func.id if isinstance(node.func, ast.Name) else ""
            if name not in FUNCTIONS or node.keywords:
                raise FormatError(f"the expression {shown(self.text)} calls {shown(name)}; {nearest(name, FUNCTIONS)}")
            if len(node.args) != FUNCTIONS[name][1]:
                raise FormatError(
                    f"the expression {shown(self.text)} gives {name} {len(node.args)} values; expected "
                    f"{FUNCTIONS[name][1]}"
                )
        elif isinstance(node, ast.Constant):
            if isinstance(node.value, bool) or not isinstance(node.value, int | float | str):
                raise FormatError(f"the expression {shown(self.text)} holds {shown(node.value)}; expected a number")
        elif not isinstance(
            node,
            (ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.Name, ast.expr_context, *_OPERATORS),
        ):
            raise FormatError(
                f"the expression {shown(self.text)} holds what is no arithmetic ({type(node).__name__}); expected "
                f"numbers, channels, + - * / **, comparisons, 'and', 'or', and {', '.join(FUNCTIONS)}"
            )

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Channels and columns that it needs, each once."""
        called = {id(n.func) for n in ast.walk(self._tree) if isinstance(n, ast.Call)}
        found = [
            n.id if isinstance(n, ast.Name) else n.value
            for n in ast.walk(self._tree)
            if (isinstance(n, ast.Name) and id(n) not in called and n.id != "pi")
            or (isinstance(n, ast.Constant) and isinstance(n.value, str))
        ]
        return tuple(dict.fromkeys(str(n) for n in found))

    def __call__(self, values: dict[str, np.ndarray]) -> np.ndarray:
        """Its value from that of each of its `names`, shape (n,) each."""
        with np.errstate(all="ignore"):  # what is not finite is missing
            return np.asarray(self._value(self._tree, values))

    def _value(self, node: Any, values: dict[str, np.ndarray]) -> Any:
        if isinstance(node, ast.Constant):
            constant: Any = node.value
            return values[constant] if isinstance(constant, str) else np.float64(constant)
        if isinstance(node, ast.Name):
            return np.pi if node.id == "pi" else values[node.id]
        if isinstance(node, ast.Call):
            name: str = node.func.id  # type: ignore[attr-defined]  # checked
            return FUNCTIONS[name][0](*(self._value(a, values) for a in node.args))
        if isinstance(node, ast.UnaryOp):
            return _OPERATORS[type(node.op)](self._value(node.operand, values))
        if isinstance(node, ast.BinOp):
            return _OPERATORS[type(node.op)](self._value(node.left, values), self._value(node.right, values))
        if isinstance(node, ast.BoolOp):
            parts = [self._value(v, values) for v in node.values]
            whole = parts[0]
            for part in parts[1:]:
                whole = _OPERATORS[type(node.op)](whole, part)
            return whole
        sides = [self._value(side, values) for side in (node.left, *node.comparators)]
        held: Any = True
        for op, left, right in zip(node.ops, sides, sides[1:], strict=False):
            held = np.logical_and(held, _OPERATORS[type(op)](left, right))
        return held
