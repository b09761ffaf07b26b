"""C of the elimination of sparse square matrices whose nonzeros are known beforehand, on several columns at once."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import casadi as ca
import numpy as np


def nonzeros(sparsity: ca.Sparsity) -> list[list[int]]:
    """Columns of the nonzeros of each row."""
    columns: list[list[int]] = [[] for _ in range(sparsity.size1())]
    for r, c in zip(*sparsity.get_triplet(), strict=True):
        columns[r].append(c)
    return columns


def stages_pattern(coupled: np.ndarray) -> list[set[int]]:
    """Columns of the nonzeros in each row of Newton's matrix for the stages of Radau IIA, three of each state in a row.

    ``coupled`` says which rates depend on which states, shape (n_states, n_states).
    """
    rows = [np.flatnonzero(row).tolist() for row in coupled | np.eye(len(coupled), dtype=bool)]
    return [{3 * b + m for b in row for m in range(3)} for row in rows for _ in range(3)]


def increments_pattern(coupled: np.ndarray) -> list[set[int]]:
    """The same of the matrix that `increments_code` writes, of the increments of states instead of their rates.

    Between two states only the same stages meet.
    """
    rows = [np.flatnonzero(row).tolist() for row in coupled]
    return [{3 * b + j for b in row} | {3 * a + m for m in range(3)} for a, row in enumerate(rows) for j in range(3)]


def increments_code(coupled: np.ndarray, name: str) -> str:
    """C of ``NAME_matrix(const V *fx, const double *G, V *m)``: the inverse of Radau's matrix less derivatives.

    ``fx`` are the derivatives of the rates at each of the three stages, whole matrices by row; ``G`` is the inverse of
    Radau's matrix times the length of the step. Only what `increments_pattern` knows is written.
    """
    n = len(coupled)
    lines = [f"static void {name}_matrix(const V *restrict fx, const double *restrict G, V *restrict m)", "{"]
    for a, b in zip(*np.nonzero(coupled | np.eye(n, dtype=bool)), strict=True):
        for j in range(3):
            for k in range(3) if a == b else [j]:
                place = (3 * a + j) * 3 * n + 3 * b + k
                own = f"v_all(G[{3 * j + k}])" if a == b else ""
                rate = f" - fx[{(j * n + a) * n + b}]" if coupled[a, b] and j == k else ""
                lines.append(f"    m[{place}] = {(own + rate).strip()};")
    return "\n".join([*lines, "}\n"])


def elimination_code(pattern: list[set[int]], name: str, kind: str = "V", *, sides: Sequence[set[int]] = ()) -> str:
    """C of ``NAME_factor(T *m)`` and ``NAME_solve(const T *m, T *b)``: factors of a square matrix without pivoting.

    ``kind`` is the type T. ``pattern`` has the columns of the nonzeros of each row. Only nonzeros and their fill are
    touched, so rows and columns that should be eliminated first, such as those of stiff wheels, come first. With
    ``sides``, the rows of the nonzeros of each, also ``NAME_solve_sides``, for so many right-hand sides, those of a row
    side by side.
    """
    n = len(pattern)
    rows = [set(p) | {i} for i, p in enumerate(pattern)]
    factor = [f"static void {name}_factor({kind} *restrict m)", "{", f"    {kind} f;"]
    for k in range(n):
        factor.append(f"    m[{k * n + k}] = 1.0 / m[{k * n + k}];")
        for i in range(k + 1, n):
            if k not in rows[i]:
                continue
            factor.append(f"    f = m[{i * n + k}] * m[{k * n + k}];")
            factor.append(f"    m[{i * n + k}] = f;")
            for j in sorted(c for c in rows[k] if c > k):
                at, term = f"m[{i * n + j}]", f"f * m[{k * n + j}]"
                factor.append(f"    {at} = {at} - {term};" if j in rows[i] else f"    {at} = -{term};")
                rows[i].add(j)
    solve = [f"static void {name}_solve(const {kind} *restrict m, {kind} *restrict b)", "{", f"    {kind} r;"]
    for i in range(n):
        left = [f" - m[{i * n + k}] * b[{k}]" for k in sorted(c for c in rows[i] if c < i)]
        if left:
            solve.append(f"    b[{i}] = b[{i}]{''.join(left)};")
    for i in reversed(range(n)):
        right = [f" - m[{i * n + k}] * b[{k}]" for k in sorted(c for c in rows[i] if c > i)]
        solve.append(f"    r = b[{i}]{''.join(right)};")
        solve.append(f"    b[{i}] = r * m[{i * n + i}];")
    return "\n".join([*factor, "}\n", *solve, "}\n", *(_solve_sides(rows, name, kind, sides) if sides else [])])


def _solve_sides(rows: list[set[int]], name: str, kind: str, sides: Sequence[set[int]]) -> list[str]:
    """The same as ``NAME_solve``, where the rows of the factors are ``rows``; what is zero in a side is left out."""
    n, count, filled = len(rows), len(sides), [set(side) for side in sides]
    lines = [
        f"static __attribute__((unused)) void {name}_solve_sides(const {kind} *restrict m, {kind} *restrict b)",
        "{",
    ]

    def row(i: int, columns: list[int], last: str) -> None:
        terms = [tuple(k for k in columns if k in side) for side in filled]
        for side, used in zip(filled, terms, strict=True):
            side.update([i] if used else [])
        for (used, there), group in groupby(range(count), lambda r: (terms[r], i in filled[r])):
            which = list(group)
            if not used and not (last and there):
                continue
            at = f"b[{i * count} + r]"
            what = "".join(f" - m[{i * n + k}] * b[{k * count} + r]" for k in used)
            lines.append(f"    for (int r = {which[0]}; r <= {which[-1]}; r++)")
            lines.append(f"        {at} = ({at}{what}){last};")

    for i in range(n):
        row(i, sorted(c for c in rows[i] if c < i), "")
    for i in reversed(range(n)):
        row(i, sorted(c for c in rows[i] if c > i), f" * m[{i * n + i}]")
    return [*lines, "}\n"]
