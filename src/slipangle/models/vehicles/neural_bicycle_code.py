"""Compiled free runs of the bicycle with a network inside: one library per architecture, whatever its numbers."""

from typing import Any

import casadi as ca
import numpy as np

from slipangle.codegen.compiler import library
from slipangle.codegen.expression import emit, preamble
from slipangle.codegen.integrators import explicit_step
from slipangle.models.black_box.networks import mlp_pass

FLAGS = ("-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast")

_LOOP = """\
void free_run(const double *w, const double *most, double *x, const double *u, long rows, double h, double *out)
{
    double y[3], k[3], sum[3];
    for (long r = 0; r < rows; r++, u += 3, out += 3) {
        for (int s = 0; s < SUBSTEPS; s++) {
            STEP
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
    """What the compiled loop reads: parameters, then every layer's weights by row and its biases."""
    params = [float(getattr(model.params, name)) for name in model.params.metadata()]
    layers, net = zip(*model.network.layers, strict=True), model.network
    straight = [] if net.straight is None else [net.straight.ravel()]
    return np.concatenate([params, *(part.ravel() for layer in layers for part in layer), *straight])


def source(model: _Bicycle) -> str:
    """C of ``free_run(w, most, x, u, n, h, out)``; ``w`` is what `numbers` says."""
    names = tuple(model.params.metadata())
    w, at = ca.SX.sym("w", len(numbers(model))), len(names)
    weights, biases, skip = model.network.unravel(w[at:])

    def network(z: Any) -> Any:
        return mlp_pass(z, weights, biases, model.network.activation, skip)

    x, u = ca.SX.sym("x", 3), ca.SX.sym("u", 3)
    values = {name: w[i] for i, name in enumerate(names)}
    rates = ca.vertcat(*model.rates(x, u, model.params.with_values(**values), network))
    function = ca.Function("rates", [x, u, w], [ca.cse(ca.densify(rates))])
    step = explicit_step("rk4", "rates({x}, u, w, {k})", n=3, h="h", out="x")
    loop = _LOOP.replace("SUBSTEPS", str(model.substeps)).replace("STEP", step.strip())
    return "\n".join([preamble("double"), emit(function, "rates"), loop])


def run(model: _Bicycle, x0: np.ndarray, u: np.ndarray) -> np.ndarray | None:
    """States after each row of ``u``, shape (n, 3); None without a compiler or for another kind of network."""
    if model.network.perceptron is None or model.method != "rk4":
        return None
    loaded = library(source(model), name="neural_bicycle", flags=FLAGS)
    if loaded is None:
        return None
    w, most, h = numbers(model), np.array([model.most_v_y, model.most_r]), model.dt / model.substeps
    x, u, out = np.array(x0, dtype=float), np.ascontiguousarray(u, dtype=float), np.empty((len(u), 3))
    loaded.free_run(w.ctypes.data, most.ctypes.data, x.ctypes.data, u.ctypes.data, len(u), h, out.ctypes.data)
    return out
