"""C of products by the derivative of a step, whose nonzeros are known."""

from __future__ import annotations

MOST_TERMS = 200  # of a product that is written out term by term


def chained(rows: list[list[int]]) -> str:
    """C of ``chained(A, from, to, stride)``: A, of these nonzeros by row, times as many rows of vectors.

    Written out row by row while that is short: loops over so few terms take longer than these.
    """
    n = len(rows)
    lines = ["static void chained(const double *restrict A, const V *restrict from, V *restrict to, int stride)", "{"]
    if sum(map(len, rows)) > MOST_TERMS:
        return "\n".join(
            [
                *lines,
                f"    for (int a = 0; a < {n}; a++) {{",
                "        V sum = {0};",
                "        for (int c = A_FIRST[a]; c < A_FIRST[a + 1]; c++)",
                f"            sum += A[a * {n} + A_AT[c]] * from[A_AT[c] * stride];",
                "        to[a * stride] = sum;",
                "    }",
                "}",
            ]
        )
    lines += [f"    const V r{c} = from[{c} * stride];" for c in sorted({c for row in rows for c in row})]
    for a, row in enumerate(rows):
        terms = " + ".join(f"A[{a * n + c}] * r{c}" for c in row)
        lines.append(f"    to[{a} * stride] = {terms or 'v_all(0.0)'};")
    return "\n".join([*lines, "}"])


def follow_on(rows: list[list[int]]) -> str:
    """C of ``follow_on(A, from, v, to)``: v plus A, of these nonzeros by row, times what the step comes from."""
    n = len(rows)
    lines = [
        "static void follow_on(const double *restrict A, const double *restrict from, const double *restrict v,",
        "                      double *restrict to)",
        "{",
    ]
    if sum(map(len, rows)) > MOST_TERMS:
        return "\n".join(
            [
                *lines,
                f"    for (int a = 0; a < {n}; a++) {{",
                "        double sum = v[a];",
                "        for (int c = A_FIRST[a]; c < A_FIRST[a + 1]; c++)",
                f"            sum += A[a * {n} + A_AT[c]] * from[A_AT[c]];",
                "        to[a] = sum;",
                "    }",
                "}",
            ]
        )
    lines += [f"    const double r{c} = from[{c}];" for c in sorted({c for row in rows for c in row})]
    lines += [f"    to[{a}] = v[{a}]{''.join(f' + A[{a * n + c}] * r{c}' for c in row)};" for a, row in enumerate(rows)]
    return "\n".join([*lines, "}"])
