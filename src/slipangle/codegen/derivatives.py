"""Jacobians of scalar expressions by elimination: fewer products than derivatives carried along in every direction.

The expression is a graph whose edges hold the derivative of each operation by its operands. Taking out an intermediate
value multiplies each of its edges in with each of its edges out, and adds products between the same two values; what is
left are edges from inputs to results. Values with one edge in or one edge out go first, those of the fewest products
before others, the rest in the order of computation (Griewank and Walther, Evaluating Derivatives, 2nd ed., chapters 9
and 10). The force of a tire, ten operations behind one slip angle, then takes ten products and not ten per direction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from heapq import heapify, heappop, heappush
from itertools import accumulate, pairwise
from typing import Any

import casadi as ca

from slipangle.codegen.inline import applied


def jacobians(results: Sequence[Any], variables: Sequence[Any]) -> list[Any]:
    """Of each result by each variable, those of the first result first.

    Equal to `casadi.jacobian` up to rounding, with the same pattern or fewer nonzeros.

    Parameters
    ----------
    results, variables : sequence of casadi.SX or casadi.MX
        Columns. Matrix expressions, and scalar ones that call a function, are differentiated by CasADi.
    """
    graph = None
    if all(isinstance(v, ca.SX) for v in (*results, *variables)):
        given, value = ca.vertcat(*variables), ca.vertcat(*results)
        others = ca.vertcat(*[s for s in ca.symvar(value) if not ca.depends_on(given, s)])
        graph = _graph(ca.Function("value", [given, others], [ca.densify(value)], {"cse": True}), [given, others])
    if graph is None:
        return [ca.jacobian(r, v) for r in results for v in variables]
    whole = graph.eliminated()
    rows, columns = (pairwise(accumulate((s.numel() for s in sizes), initial=0)) for sizes in (results, variables))
    columns = list(columns)
    return [whole[i:j, k:m] for i, j in rows for k, m in columns]


class _Graph:
    """Values by number, inputs first; ``into[b][a]`` is the derivative of b by a, ``out_of[a]`` holds such b.

    A derivative is an expression, a number, or, where a condition drops what is behind it, a function of that.
    """

    def __init__(self, n_inputs: int) -> None:
        self.n_inputs = n_inputs
        self.into: list[dict[int, Any]] = [{} for _ in range(n_inputs)]
        self.out_of: list[dict[int, None]] = [{} for _ in range(n_inputs)]
        self.guarded: set[int] = set()  # values that a condition keeps or drops
        self.singular: set[int] = set()  # values whose derivatives may be infinite
        self.results: list[int | None] = []  # the value of each, None if that is constant

    def add(self, edges: dict[int, Any]) -> int:
        """A value with its derivatives by others."""
        new = len(self.into)
        self.into.append(edges)
        self.out_of.append({})
        for a in edges:
            self.out_of[a][new] = None
        return new

    def eliminated(self) -> Any:
        """Derivatives of the results by the inputs."""
        inner = range(self.n_inputs, len(self.into))
        ends = [None if v is None else self.add({v: 1.0}) for v in self.results]
        for v in reversed(inner):
            if not self.out_of[v]:  # only conditions ask for it
                self._take_out(v)
        self._open_guards(range(inner.stop, len(self.into)))
        cost = {v: self._cost(v) for v in inner}
        waiting = [(c, v) for v, c in cost.items()]
        heapify(waiting)
        while waiting:
            c, v = heappop(waiting)
            if cost.get(v) != c or not self._ready(v):
                continue  # it comes again when that has changed
            del cost[v]
            for w in self._take_out(v):
                if w in cost:
                    cost[w] = self._cost(w)
                    heappush(waiting, (cost[w], w))
        whole = ca.SX(len(ends), self.n_inputs)
        for row, v in enumerate(ends):
            for a, w in () if v is None else self.into[v].items():
                whole[row, a] = w
        return whole

    def _cost(self, v: int) -> tuple[int, int]:
        """The least goes first."""
        into, ahead = self.into[v].values(), [self.into[b][v] for b in self.out_of[v]]
        if min(len(into), len(ahead)) > 1:
            return 1, v
        products = sum(not _unit(w) for w in into) * sum(not _unit(w) for w in ahead)
        return 0, 4 * products + len(into) * len(ahead)  # those by one are free, sums are not

    def _ready(self, v: int) -> bool:
        """Whether a value may go. Behind a condition inputs go first: of a dropped case infinite times zero is zero."""
        free = v not in self.guarded or all(a < self.n_inputs for a in self.into[v])
        return free and not any(callable(w) for w in self.into[v].values())

    def _open_guards(self, ends: Iterable[int]) -> None:
        """Conditions are factors where all that only they let through has finite derivatives, such as those of |v|."""
        plain = self._behind(ends, lambda a, b: not callable(self.into[b][a]))
        for a in list(self.guarded):
            hidden = self._behind([a], lambda a, b: a not in plain)
            if a not in plain and hidden & self.singular:
                continue
            self.guarded.discard(a)
            for b in self.out_of[a]:
                w = self.into[b][a]
                self.into[b][a] = w(1.0) if callable(w) else w

    def _behind(self, ends: Iterable[int], through: Callable[[int, int], bool]) -> set[int]:
        """Values, these included, that lead there by edges ``(a, b)`` that are let through."""
        waiting = list(ends)
        found = set(waiting)
        while waiting:
            b = waiting.pop()
            new = {a for a in self.into[b] if a not in found and through(a, b)}
            found |= new
            waiting += new
        return found

    def _take_out(self, v: int) -> set[int]:
        """Eliminate a value; those of which this changes the cost."""
        behind, ahead = self.into[v], self.out_of[v]
        for b in ahead:
            last = self.into[b].pop(v)
            for a, first in behind.items():
                new = last(first) if callable(last) else _product(last, first)
                old = self.into[b].get(a)
                self.into[b][a] = new if old is None else _sum(old, new)
                self.out_of[a][b] = None
        for a in behind:
            del self.out_of[a][v]
        self.into[v], self.out_of[v] = {}, {}
        return {*behind, *ahead}


def _graph(function: ca.Function, given: Sequence[Any]) -> _Graph | None:
    """Of a function of scalar instructions, to be differentiated by its first input. None if it calls functions."""
    graph = _Graph(given[0].numel())
    work: dict[int, tuple[Any, int | None]] = {}
    graph.results = [None] * function.numel_out(0)
    for k in range(function.n_instructions()):
        op, inputs, outputs = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_CALL:
            return None
        if op == ca.OP_OUTPUT:
            graph.results[outputs[1]] = work[inputs[0]][1]
        elif op == ca.OP_INPUT:
            work[outputs[0]] = given[inputs[0]].nz[inputs[1]], None if inputs[0] else inputs[1]
        elif op == ca.OP_CONST:
            work[outputs[0]] = ca.SX(function.instruction_constant(k)), None
        else:
            expressions, values = zip(*(work[i] for i in inputs), strict=True)
            work[outputs[0]] = applied(op, expressions), _added(graph, op, expressions, values)
    return graph


def _added(graph: _Graph, op: int, given: Sequence[Any], values: Sequence[int | None]) -> int | None:
    """The new value of an operation in the graph; None if none of its operands moves it."""
    moved = [i for i, v in enumerate(values) if v is not None]
    if not moved:
        return None
    edges: dict[int, Any] = {}
    if op == ca.OP_IF_ELSE_ZERO:
        kept = values[1]
        if kept is None:
            return None
        edges[kept] = partial(ca.SX.binary, op, given[0])
        graph.guarded.add(kept)
    else:
        slopes = _slopes(op, given)
        for i in moved:
            a: Any = values[i]
            if _zero(slopes[i]):
                continue
            edges[a] = _sum(edges[a], slopes[i]) if a in edges else slopes[i]
    if not edges:
        return None
    new = graph.add(edges)
    if op not in _REGULAR and not (op == ca.OP_DIV and values[1] is None):
        graph.singular.add(new)
    return new


_REGULAR = frozenset(  # operations with finite derivatives everywhere
    getattr(ca, f"OP_{name}")
    for name in "ADD SUB MUL NEG SQ TWICE FABS FMIN FMAX SIN COS ATAN TANH SIGN IF_ELSE_ZERO COPYSIGN".split()
)


def _slopes(op: int, given: Sequence[Any]) -> Sequence[Any]:
    """Derivatives of one operation by its operands."""
    if op == ca.OP_MUL:
        return given[::-1]
    if op in _NUMBERS:
        return _NUMBERS[op]
    return _rule(op, len(given)).call(given)


_NUMBERS = {ca.OP_ADD: (1.0, 1.0), ca.OP_SUB: (1.0, -1.0), ca.OP_NEG: (-1.0,), ca.OP_TWICE: (2.0,)}


@cache
def _rule(op: int, n: int) -> ca.Function:
    """Derivatives of one operation as CasADi knows them."""
    given = [ca.SX.sym(f"a{i}") for i in range(n)]
    value = applied(op, given)
    return ca.Function("rule", given, [ca.densify(ca.jacobian(value, a)) for a in given])


def _product(a: Any, b: Any) -> Any:
    """Of two derivatives, which may be numbers."""
    for one, other in ((a, b), (b, a)):
        if isinstance(one, float) and abs(one) == 1.0:
            return other if one > 0.0 else -other
    if isinstance(a, float) and isinstance(b, float):
        return a * b
    return ca.SX.binary(ca.OP_MUL, _expression(a), _expression(b))


def _sum(a: Any, b: Any) -> Any:
    if isinstance(a, float) and isinstance(b, float):
        return a + b
    return ca.SX.binary(ca.OP_ADD, _expression(a), _expression(b))


def _expression(a: Any) -> Any:
    return ca.SX(a) if isinstance(a, float) else a


def _unit(weight: Any) -> bool:
    return isinstance(weight, float) and abs(weight) == 1.0


def _zero(weight: Any) -> bool:
    return weight == 0.0 if isinstance(weight, float) else weight.is_zero()
