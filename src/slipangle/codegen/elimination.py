"""C of the elimination of sparse square matrices whose nonzeros are known beforehand, on several columns at once."""

from __future__ import annotations

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


def stages_code(coupled: np.ndarray, name: str) -> str:
    """C of ``NAME_matrix(const V *fx, const double *H, V *m)``: that matrix, the identity less H times derivatives.

    ``fx`` are the derivatives of the rates at each of the three stages, whole matrices by row; ``H`` is Radau's matrix
    times the length of the step. Only what `stages_pattern` knows is written.
    """
    n = len(coupled)
    lines = [f"static void {name}_matrix(const V *restrict fx, const double *restrict H, V *restrict m)", "{"]
    for a, b in zip(*np.nonzero(coupled | np.eye(n, dtype=bool)), strict=True):
        for j in range(3):
            for m in range(3):
                place, one = (3 * a + j) * 3 * n + 3 * b + m, " + 1.0" if a == b and j == m else ""
                lines.append(f"    m[{place}] = -H[{3 * j + m}] * fx[{(j * n + a) * n + b}]{one};")
    return "\n".join([*lines, "}\n"])


def elimination_code(pattern: list[set[int]], name: str, kind: str = "V", *, sides: str = "") -> str:
    """C of ``NAME_factor(T *m)`` and ``NAME_solve(const T *m, T *b)``: factors of a square matrix without pivoting.

    ``kind`` is the type T. ``pattern`` has the columns of the nonzeros of each row. Only nonzeros and their fill are
    touched, so rows and columns that should be eliminated first, such as those of stiff wheels, come first. With
    ``sides``, a count in C, also ``NAME_solve_sides``, for so many right-hand sides, those of a row side by side.
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


def _solve_sides(rows: list[set[int]], name: str, kind: str, sides: str) -> list[str]:
    """The same as ``NAME_solve``, where the rows of the factors are ``rows``."""
    n = len(rows)
    lines = [
        f"static __attribute__((unused)) void {name}_solve_sides(const {kind} *restrict m, {kind} *restrict b)",
        "{",
    ]

    def row(i: int, columns: list[int], last: str) -> None:
        terms = "".join(f" - m[{i * n + k}] * b[{k} * {sides} + r]" for k in columns)
        if terms or last:
            lines.append(f"    for (int r = 0; r < {sides}; r++)")
            at = f"b[{i} * {sides} + r]"
            lines.append(f"        {at} = ({at}{terms}){last};")

    for i in range(n):
        row(i, sorted(c for c in rows[i] if c < i), "")
    for i in reversed(range(n)):
        row(i, sorted(c for c in rows[i] if c > i), f" * m[{i * n + i}]")
    return [*lines, "}\n"]
