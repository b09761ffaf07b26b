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

_ACTIVATION = {
    "elu": "v4_pick(z > 0.0, z, v4_expm1(v4_fmin(v4_all(0.0), z)))",
    "tanh": "v4_tanh(z)",
    "sigmoid": "0.5 + 0.5 * v4_tanh(0.5 * z)",
}


def _padded(n: int) -> int:
    return -(-n // LANES) * LANES


def _blocks(n_out: int) -> list[int]:
    """Vectors of each block of a layer, as even as possible."""
    vectors = _padded(n_out) // LANES
    count = -(-vectors // _REGISTERS)
    return [vectors // count + (i < vectors % count) for i in range(count)]


def emit_forward(sizes: Sequence[int], activation: Activation, *, name: str = "forward", straight: bool = False) -> str:
    """C of ``static void NAME(const double *w, const double *z, double *out)``; put ``preamble("v4")`` before it.

    ``sizes`` are inputs, neurons of each hidden layer, outputs; ``w`` is `packed`, 32-byte aligned; ``z`` and ``out``
    are in SI units. ``straight`` says that a linear path past the layers follows their weights.
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
            body.append(f"    {{ const v4 z = {target}[i]; {target}[i] = {_ACTIVATION[activation]}; }}")
        else:
            body.append(f"    for (int i = 0; i < {n_out}; i++)")
            body.append(f"        out[i] = ((const double *){target})[i];")
        source = target
    if straight:
        body.append(f"    for (int i = 0; i < {sizes[-1]}; i++)")
        body.append(f"        for (int j = 0; j < {sizes[0]}; j++) out[i] += w[i * {sizes[0]} + j] * z[j];")
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


def packed(
    weights: Sequence[np.ndarray], biases: Sequence[np.ndarray], straight: np.ndarray | None = None
) -> np.ndarray:
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
    if straight is not None:
        parts.append(np.pad(straight.ravel(), (0, _padded(straight.size) - straight.size)))
    return aligned(np.concatenate(parts))


def aligned(values: np.ndarray, bytes_: int = 64) -> np.ndarray:
    """A copy of an array of doubles that starts at a multiple of ``bytes_``, as vectors in memory do."""
    raw = np.empty(values.nbytes + bytes_, dtype=np.uint8)
    start = -raw.ctypes.data % bytes_
    place = raw[start : start + values.nbytes].view(float).reshape(values.shape)
    place[...] = values
    return place
