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


def elimination_code(pattern: list[set[int]], name: str, kind: str = "V") -> str:
    """C of ``NAME_factor(T *m)`` and ``NAME_solve(const T *m, T *b)``: factors of a square matrix without pivoting.

    ``kind`` is the type T. ``pattern`` has the columns of the nonzeros of each row. Only nonzeros and their fill are
    touched, so rows and columns that should be eliminated first, such as those of stiff wheels, come first.
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
    return "\n".join([*factor, "}\n", *solve, "}\n"])
