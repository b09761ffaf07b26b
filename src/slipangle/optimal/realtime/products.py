"""C of products by the derivative of a step, whose nonzeros are known."""

from __future__ import annotations

MOST_TERMS = 200  # of a product that is written out term by term


def chained(rows: list[list[int]]) -> str:
    """C of ``chained(A, from, to, stride)``: A, of these nonzeros by row, times as many rows of vectors."""
    head = "static void chained(const double *restrict A, const V *restrict from, V *restrict to, int stride)"
    return _product(head, rows, number="V", at=" * stride")


def follow_on(rows: list[list[int]]) -> str:
    """C of ``follow_on(A, from, v, to)``: v plus A, of these nonzeros by row, times what the step comes from."""
    head = """\
static void follow_on(const double *restrict A, const double *restrict from, const double *restrict v,
                      double *restrict to)"""
    return _product(head, rows, number="double", added="v")


def _product(head: str, rows: list[list[int]], *, number: str, at: str = "", added: str = "") -> str:
    """C of a product of A and ``from``, on top of ``added``: numbers of a type, at places times what ``at`` says.

    Written out row by row while that is short: loops over so few terms take longer than these.
    """
    n, lines = len(rows), [head, "{"]
    if sum(map(len, rows)) > MOST_TERMS:
        lines += [
            f"    for (int a = 0; a < {n}; a++) {{",
            f"        {number} sum = {f'{added}[a]' if added else '{0}'};",
            "        for (int c = A_FIRST[a]; c < A_FIRST[a + 1]; c++)",
            f"            sum += A[a * {n} + A_AT[c]] * from[A_AT[c]{at}];",
            f"        to[a{at}] = sum;",
            "    }",
        ]
        return "\n".join([*lines, "}"])
    lines += [f"    const {number} r{c} = from[{c}{at}];" for c in sorted({c for row in rows for c in row})]
    for a, row in enumerate(rows):
        terms = [*([f"{added}[{a}]"] if added else []), *(f"A[{a * n + c}] * r{c}" for c in row)]
        lines.append(f"    to[{a}{at}] = {' + '.join(terms) or 'v_all(0.0)'};")
    return "\n".join([*lines, "}"])
