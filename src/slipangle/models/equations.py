"""`Recorded`: equations of your own as a list of elementary operations, which a readable file can keep."""

import operator
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Self

import casadi as ca
import numpy as np

from slipangle import ops
from slipangle.data.numerals import is_number
from slipangle.errors import ParameterError, nearest
from slipangle.ops import Scalar, Vector


def _as_number(holds: Any) -> Scalar:
    return ops.where(holds, 1.0, 0.0)


_OPERATIONS: dict[str, tuple[int, int, Callable[..., Scalar]]] = {  # name: CasADi's code, operands, meaning
    **{  # those that CasADi, C and `slipangle.ops` call by one name
        name: (getattr(ca, f"OP_{name.upper()}"), count, getattr(ops, name))
        for count, names in ((1, "sqrt sin cos tan asin atan sinh cosh tanh exp log sign"), (2, "atan2 hypot"))
        for name in names.split()
    },
    "same": (ca.OP_ASSIGN, 1, operator.pos),
    "negative": (ca.OP_NEG, 1, operator.neg),
    "square": (ca.OP_SQ, 1, lambda a: a * a),
    "twice": (ca.OP_TWICE, 1, lambda a: a + a),
    "inverse": (ca.OP_INV, 1, lambda a: 1.0 / a),
    "not": (ca.OP_NOT, 1, lambda a: 1.0 - a),
    "abs": (ca.OP_FABS, 1, ops.fabs),
    "add": (ca.OP_ADD, 2, operator.add),
    "subtract": (ca.OP_SUB, 2, operator.sub),
    "multiply": (ca.OP_MUL, 2, operator.mul),
    "divide": (ca.OP_DIV, 2, operator.truediv),
    "power": (ca.OP_POW, 2, operator.pow),
    "power_constant": (ca.OP_CONSTPOW, 2, operator.pow),
    "minimum": (ca.OP_FMIN, 2, ops.minimum),
    "maximum": (ca.OP_FMAX, 2, ops.maximum),
    "less": (ca.OP_LT, 2, lambda a, b: _as_number(a < b)),
    "less_equal": (ca.OP_LE, 2, lambda a, b: _as_number(a <= b)),
    "equal": (ca.OP_EQ, 2, lambda a, b: _as_number(a == b)),
    "not_equal": (ca.OP_NE, 2, lambda a, b: _as_number(a != b)),
    "and": (ca.OP_AND, 2, operator.mul),
    "or": (ca.OP_OR, 2, ops.maximum),
    "if": (ca.OP_IF_ELSE_ZERO, 2, lambda a, b: ops.where(a != 0.0, b, 0.0)),
}
_NAME_OF = {code: name for name, (code, _, _) in _OPERATIONS.items()}


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """Functions of states, inputs and parameters, one elementary operation a line.

    Raises ParameterError if a line is none of those below, with its number.

    Parameters
    ----------
    lines : tuple of str
        Line ``k`` makes value ``k``: ``"x 0"``, ``"u 1"``, ``"p stiffness"``, ``"number 2.5"``, ``"multiply 0 2"`` (of
        the values of lines 0 and 2), ``"sin 3"`` and so on.
    results : tuple of int
        Lines whose values are the results.
    names : tuple of str
        Names of the results; empty for rates, which need none.
    vectors : tuple of str
        Names of the arguments before the parameters, in order; of implicit equations ``x_dot`` and ``z`` too.
    """

    lines: tuple[str, ...]
    results: tuple[int, ...]
    names: tuple[str, ...] = ()
    vectors: tuple[str, ...] = field(default=("x", "u"), metadata={"may be missing in a file": True})

    def __post_init__(self) -> None:
        for k, line in enumerate(self.lines):
            self._check(k, line)
        if any(not 0 <= r < len(self.lines) for r in self.results) or len(self.names) not in (0, len(self.results)):
            raise ParameterError(
                f"the results {self.results} are named {self.names}; expected lines from 0 to {len(self.lines) - 1}, "
                "each with a name or none"
            )

    def _check(self, k: int, line: str) -> None:
        word, *rest = line.split()
        if word in _OPERATIONS:
            fine = len(rest) == _OPERATIONS[word][1] and all(r.isdigit() and int(r) < k for r in rest)
        elif word in self.vectors:
            fine = len(rest) == 1 and rest[0].isdigit()
        elif word == "p":
            fine = len(rest) == 1 and rest[0].isidentifier()
        else:
            fine = word == "number" and len(rest) == 1 and is_number(rest[0])
        if not fine:
            known = (*_OPERATIONS, *self.vectors, "p", "number")
            raise ParameterError(
                f"line {k} of the equations is {line!r}; {nearest(word, known)}: "
                f"expected an operation on earlier lines, {', '.join(self.vectors)}, p or number"
            )

    @classmethod
    def of(cls, f: Any, params: Any, **sizes: int) -> Self:
        """Record ``f(x, u, p)``, or with other vectors of these ``sizes``, which gives a vector, or values by name.

        Raises ParameterError if it has an operation that cannot be recorded.
        """
        names = tuple(params.metadata())
        given, p = [ca.SX.sym(name, n) for name, n in sizes.items()], ca.SX.sym("p", len(names))
        value = f(*given, params.with_values(**{n: p[i] for i, n in enumerate(names)}))
        labels = tuple(value) if isinstance(value, dict) else ()
        flat = list(value.values()) if isinstance(value, dict) else value
        vector = flat if isinstance(flat, ca.SX) else ca.vertcat(*flat)
        return cls._from(ca.Function("f", [*given, p], [ca.densify(vector)]), names, labels, tuple(sizes))

    @classmethod
    def _from(
        cls, function: ca.Function, names: tuple[str, ...], labels: tuple[str, ...], vectors: tuple[str, ...]
    ) -> Self:
        lines: list[str] = []
        place: dict[int, int] = {}  # where in CasADi's memory: line
        results = [0] * function.size1_out(0)
        for k in range(function.n_instructions()):
            code = function.instruction_id(k)
            inputs, outputs = function.instruction_input(k), function.instruction_output(k)
            if code == ca.OP_OUTPUT:
                results[outputs[1]] = place[inputs[0]]
                continue
            if code == ca.OP_CONST:
                line = f"number {function.instruction_constant(k)!r}"
            elif code == ca.OP_INPUT:
                at, i = inputs[:2]
                line = f"p {names[i]}" if at == len(vectors) else f"{vectors[at]} {i}"
            elif code in _NAME_OF:
                line = " ".join([_NAME_OF[code], *(str(place[i]) for i in inputs[: _OPERATIONS[_NAME_OF[code]][1]])])
            else:
                raise ParameterError(
                    f"the equations use CasADi's operation {code}, which cannot be recorded; expected arithmetic and "
                    "functions of slipangle.ops"
                )
            place[outputs[0]] = len(lines)
            lines.append(line)
        return cls(lines=tuple(lines), results=tuple(results), names=labels, vectors=vectors)

    def __call__(self, *given: Vector) -> Any:
        """The results: a list, or a dictionary where they have names; of the vectors, then the parameters."""
        values: list[Any] = []
        *vectors, p = given
        known = dict(zip(self.vectors, vectors, strict=True))
        for line in self.lines:
            word, *rest = line.split()
            if word in _OPERATIONS:
                values.append(_OPERATIONS[word][2](*(values[int(r)] for r in rest)))
            elif word == "p":
                values.append(getattr(p, rest[0]))
            elif word == "number":
                values.append(np.float64(rest[0]))
            else:
                values.append(known[word][int(rest[0])])
        results = [values[r] for r in self.results]
        return dict(zip(self.names, results, strict=True)) if self.names else results
