"""C source of a perceptron's forward pass, with the neurons of a layer side by side in vector registers.

The source depends on the architecture alone; the weights are an argument (`packed`), so one compiled library serves
every network of that shape. It needs the vector extensions that GCC, Clang and Zig share.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

import numpy as np

Activation = Literal["sigmoid", "tanh", "elu"]
LANES = 4  # doubles in one vector
_REGISTERS = 13  # accumulators at once; 16 vector registers must also hold the input and temporaries
_FEW_OUTPUTS = 3  # up to here a layer is computed as dot products


PREAMBLE = """\
typedef double v4 __attribute__((vector_size(32), aligned(32)));
typedef long long v4i __attribute__((vector_size(32), aligned(32)));

/* a where the mask is set, else b */
static inline v4 pick(v4i mask, v4 a, v4 b)
{
    return (v4)((mask & (v4i)a) | (~mask & (v4i)b));
}

/* exp of x <= 0, to about one unit in the last place: x = n ln 2 + r, Taylor series in r, exponent bits from n. */
static inline v4 exp_negative(v4 x)
{
    const v4 shift = {0x1.8p52, 0x1.8p52, 0x1.8p52, 0x1.8p52};
    const v4 least = {-700.0, -700.0, -700.0, -700.0};
    x = pick(x < least, least, x);
    v4 shifted = x * 0x1.71547652b82fep0 + shift;
    v4 n = shifted - shift;
    v4 r = (x - n * 0x1.62e42fefa39efp-1) - n * 0x1.abc9e3b39803fp-56;
    v4 p = r * (1.0 / 479001600.0) + (1.0 / 39916800.0);
    p = p * r + (1.0 / 3628800.0);
    p = p * r + (1.0 / 362880.0);
    p = p * r + (1.0 / 40320.0);
    p = p * r + (1.0 / 5040.0);
    p = p * r + (1.0 / 720.0);
    p = p * r + (1.0 / 120.0);
    p = p * r + (1.0 / 24.0);
    p = p * r + (1.0 / 6.0);
    p = p * r + 0.5;
    p = p * r + 1.0;
    p = p * r + 1.0;
    v4i bits = ((v4i)shifted - (v4i)shift + 1023) << 52;
    return p * (v4)bits;
}

static inline v4 act_elu(v4 z)
{
    const v4 zero = {0.0, 0.0, 0.0, 0.0};
    v4 below = exp_negative(pick(z > zero, zero, z)) - 1.0;
    return pick(z > zero, z, below);
}

static inline v4 act_tanh(v4 z)
{
    const v4 zero = {0.0, 0.0, 0.0, 0.0};
    v4 size = pick(z < zero, -z, z);
    v4 e = exp_negative(-2.0 * size);
    v4 t = (1.0 - e) / (1.0 + e);
    return pick(z < zero, -t, t);
}

static inline v4 act_sigmoid(v4 z)
{
    return 0.5 + 0.5 * act_tanh(0.5 * z);
}
"""


def _padded(n: int) -> int:
    return -(-n // LANES) * LANES


def _blocks(n_out: int) -> list[int]:
    """Vectors of each block of a layer, as even as possible."""
    vectors = _padded(n_out) // LANES
    count = -(-vectors // _REGISTERS)
    return [vectors // count + (i < vectors % count) for i in range(count)]


def emit_forward(sizes: Sequence[int], activation: Activation, *, name: str = "forward") -> str:
    """C of ``static void NAME(const double *w, const double *z, double *out)``; put `PREAMBLE` before it.

    Parameters
    ----------
    sizes : sequence of int
        Inputs, neurons of each hidden layer, outputs.
    activation : {"sigmoid", "tanh", "elu"}
        Of the hidden layers.
    name : str
        Of the C function. ``w`` is `packed`, 32-byte aligned; ``z`` and ``out`` are in SI units.
    """
    body: list[str] = []
    source = "z"
    last = len(sizes) - 2
    for k, (n_in, n_out) in enumerate(pairwise(sizes)):
        if k == last and n_out <= _FEW_OUTPUTS and k > 0:
            body += _emit_dots(n_in, n_out, source)
            continue
        target = f"h{k}"
        body.append(f"    v4 {target}[{_padded(n_out) // LANES}];")
        body += _emit_layer(k, n_in, n_out, source)
        if k < last:
            body.append(f"    for (int i = 0; i < {_padded(n_out) // LANES}; i++)")
            body.append(f"        {target}[i] = act_{activation}({target}[i]);")
        else:
            body.append(f"    for (int i = 0; i < {n_out}; i++)")
            body.append(f"        out[i] = ((const double *){target})[i];")
        source = target
    head = f"static void {name}(const double *restrict w, const double *restrict z, double *restrict out)"
    return "\n".join([head, "{", *body, "}", ""])


def _emit_layer(k: int, n_in: int, n_out: int, source: str) -> list[str]:
    """Every input times its column of weights, added to accumulators that stay in registers."""
    lines, first = [], 0
    for count in _blocks(n_out):
        lines.append("    {")
        lines.append("        const v4 *c = (const v4 *)w;")
        lines += [f"        v4 a{i} = c[{i}];" for i in range(count)]
        lines.append(f"        c += {count};")
        lines.append(f"        for (int j = 0; j < {n_in}; j++, c += {count}) {{")
        lines.append(f"            double x = ((const double *){source})[j];")
        lines += [f"            a{i} += c[{i}] * x;" for i in range(count)]
        lines.append("        }")
        lines += [f"        h{k}[{first + i}] = a{i};" for i in range(count)]
        lines.append(f"        w += {(n_in + 1) * count * LANES};")
        lines.append("    }")
        first += count
    return lines


def _emit_dots(n_in: int, n_out: int, source: str) -> list[str]:
    """One dot product per output, four partial sums wide."""
    vectors = _padded(n_in) // LANES
    lines = []
    for row in range(n_out):
        lines.append("    {")
        lines.append("        const v4 *c = (const v4 *)w;")
        used = min(LANES, vectors)
        lines += [f"        v4 s{i} = {source}[{i}] * c[{i}];" for i in range(used)]
        lines += [f"        s{i % used} += {source}[{i}] * c[{i}];" for i in range(used, vectors)]
        total = " + ".join(f"s{i}" for i in range(used))
        lines.append(f"        v4 s = {total};")
        lines.append(f"        out[{row}] = (s[0] + s[1]) + (s[2] + s[3]) + w[{vectors * LANES}];")
        lines.append(f"        w += {(vectors + 1) * LANES};")
        lines.append("    }")
    return lines


def packed(weights: Sequence[np.ndarray], biases: Sequence[np.ndarray]) -> np.ndarray:
    """A network's layers, in SI, in the order in which `emit_forward` reads them; 32-byte aligned."""
    last = len(weights) - 1
    parts: list[np.ndarray] = []
    for k, (w, b) in enumerate(zip(weights, biases, strict=True)):
        n_out, n_in = w.shape
        if k == last and n_out <= _FEW_OUTPUTS and k > 0:
            for row in range(n_out):
                parts += [np.pad(w[row], (0, _padded(n_in) - n_in)), np.array([b[row], 0.0, 0.0, 0.0])]
            continue
        columns = np.zeros((n_in + 1, _padded(n_out)))
        columns[0, :n_out], columns[1:, :n_out] = b, w.T
        first = 0
        for count in _blocks(n_out):
            parts.append(columns[:, first : first + count * LANES].ravel())
            first += count * LANES
    return aligned(np.concatenate(parts))


def aligned(values: np.ndarray, bytes_: int = 32) -> np.ndarray:
    """A copy of a vector of doubles that starts at a multiple of ``bytes_``."""
    raw = np.empty(values.nbytes + bytes_, dtype=np.uint8)
    start = -raw.ctypes.data % bytes_
    place = raw[start : start + values.nbytes].view(float)
    place[:] = values
    return place
