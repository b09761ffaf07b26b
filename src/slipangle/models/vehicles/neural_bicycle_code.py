"""Compiled free runs of the bicycle with a network inside: one library per architecture, whatever its numbers."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from slipangle.codegen.compiler import library
from slipangle.codegen.expression import emit, preamble
from slipangle.models.black_box.networks import mlp_pass

FLAGS = ("-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast")

_LOOP = """\
void free_run(const double *w, const double *most, double *x, const double *u, long n, double h, double *out)
{
    double k[4][3], y[3];
    for (long i = 0; i < n; i++, u += 3, out += 3) {
        for (int s = 0; s < SUBSTEPS; s++) {
            rates(x, u, w, k[0]);
            for (int stage = 1; stage < 4; stage++) {
                for (int j = 0; j < 3; j++)
                    y[j] = x[j] + (stage < 3 ? 0.5 : 1.0) * h * k[stage - 1][j];
                rates(y, u, w, k[stage]);
            }
            for (int j = 0; j < 3; j++)
                x[j] += h / 6.0 * (k[0][j] + 2.0 * k[1][j] + 2.0 * k[2][j] + k[3][j]);
        }
        for (int j = 0; j < 2; j++)
            x[j] = x[j] > most[j] ? most[j] : x[j] < -most[j] ? -most[j] : x[j];
        for (int j = 0; j < 3; j++)
            out[j] = x[j];
    }
}
"""


_Bicycle = Any  # a NeuralBicycle, whose file needs this one


def numbers(model: _Bicycle) -> np.ndarray:
    """What the compiled loop reads: parameters, scaling, weights."""
    net: Any = model.network
    scaling = (net.input_scaling.offset, net.input_scaling.factor, net.output_scaling.offset, net.output_scaling.factor)
    params = [float(getattr(model.params, name)) for name in model.params.metadata()]
    return np.concatenate([params, *scaling, net.parameters])


def source(model: _Bicycle) -> str:
    """C of ``free_run(w, most, x, u, n, h, out)``; ``w`` is what `numbers` says."""
    net: Any = model.network
    w = ca.SX.sym("w", len(numbers(model)))
    names = tuple(model.params.metadata())
    values = {name: w[i] for i, name in enumerate(names)}
    at = len(names)

    def take(rows: int, columns: int = 1) -> ca.SX:
        nonlocal at
        part = w[at : at + rows * columns]
        at += rows * columns
        return ca.reshape(part, columns, rows).T if columns > 1 else part

    offset_in, factor_in = take(net.n_inputs), take(net.n_inputs)
    offset_out, factor_out = take(net.n_outputs), take(net.n_outputs)
    weights, biases = [], []
    for matrix, bias in zip(net.weights, net.biases, strict=True):
        weights.append(take(*np.shape(matrix)))
        biases.append(take(len(bias)))

    def network(z: Any) -> Any:
        y = mlp_pass((z - offset_in) / factor_in, weights, biases, net.activation)
        return y * factor_out + offset_out

    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 3)
    rates = ca.vertcat(*model.rates(x, u, model.params.with_values(**values), network))
    function = ca.Function("rates", [x, u, w], [ca.cse(ca.densify(rates))])
    return "\n".join([preamble("double"), emit(function, "rates"), f"#define SUBSTEPS {model.substeps}", _LOOP])


def run(model: _Bicycle, x0: np.ndarray, u: np.ndarray) -> np.ndarray | None:
    """States after each row of ``u``, shape (n, 3); None without a compiler or for another kind of network."""
    if model.network.perceptron is None or model.method != "rk4":
        return None
    loaded = library(source(model), name="neural_bicycle", flags=FLAGS)
    if loaded is None:
        return None
    w, most = numbers(model), np.array([model.most_v_y, model.most_r])
    x, u = np.array(x0, dtype=float), np.ascontiguousarray(u, dtype=float)
    out = np.empty((len(u), 3))
    h = model.dt / model.substeps
    loaded.free_run(w.ctypes.data, most.ctypes.data, x.ctypes.data, u.ctypes.data, len(u), h, out.ctypes.data)
    return out
