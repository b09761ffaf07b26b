"""`FastPaths`: what loops, fits and plants ask of a model so that it runs fast, with defaults that always work."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, Protocol

import casadi as ca
import numpy as np

from slipangle.errors import ParameterError

_CHUNK, _FEWEST = 256, 32  # samples per call of the virtual machine: most, and what fewer are made up to a whole of


class Steps(Protocol):
    """Compiled steps in a row."""

    def run(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """States, shape (n + 1, n_states), the first being ``x``, from inputs, shape (n, n_inputs)."""
        ...


class FastPaths:
    """The part of every `Model` that is about speed alone; nobody asks of what class a model is to run it faster.

    The defaults evaluate `Model.functions` on CasADi's virtual machine. A model that can do better overrides what it
    can; each must give what the default gives, which a test checks of every model. What fits need, the derivatives by
    parameters, `slipangle.models.ode.Parametrised` describes.
    """

    functions: Any  # step(x, u), output(x, u), correct(x, u, y) of CasADi

    def free_run(self, x0: np.ndarray, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Outputs of a free run at every row of the inputs but the first, shape (n - 1, n_outputs).

        ``x0``, shape (n_states,), is the state at the first row of ``u``, shape (n, n_inputs). The result may be
        written to ``out``, of its shape, to save an array; it is the result then.
        """
        step, output, _ = self.functions
        return evaluate(output, roll_out(step, x0, u[:-1])[1:], u[1:])

    def track(self, x0: np.ndarray, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """States at every row after the first, which belongs to ``x0``, each given the outputs of the rows before."""
        step, _, correct = self.functions
        x, now, seen = (ca.MX.sym(f"s{i}", correct.size1_in(i)) for i in range(3))
        observe = ca.Function("observe", [x, ca.vertcat(now, seen)], [step(correct(x, now, seen), now)])
        return roll_out(observe, np.asarray(step(x0, u[0])).ravel(), np.hstack([u, y])[1:-1])

    def advance(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """One step from many states at once, rows are samples."""
        return evaluate(self.functions[0], x, u)

    def outputs_at(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Outputs of many states and inputs at once, shape (n, n_outputs); rows are samples."""
        return evaluate(self.functions[1], x, u)

    @property
    def steps(self) -> Steps | None:
        """Compiled steps, for plants; None where there are none: then a plant evaluates `functions`."""
        return None

    @property
    def poles(self) -> np.ndarray | None:
        """Poles of a linear model, shape (n_poles,); None of another."""
        return None


def roll_out(step: ca.Function, x0: np.ndarray, u: np.ndarray) -> np.ndarray:
    """States from repeated steps, shape (n + 1, n_states), the first being ``x0``."""
    x = np.empty((len(u) + 1, len(x0)))
    x[0] = x0
    if len(u) == 0:
        return x
    chunk = min(_CHUNK, -(-len(u) // _FEWEST) * _FEWEST)
    now = np.array(x0, dtype=float)
    inputs = np.empty((chunk, u.shape[1]))
    out = np.empty((chunk, len(x0)))
    run = bind(_repeated(step, chunk), [now, inputs], out)
    for done in range(0, len(u), chunk):
        n = min(chunk, len(u) - done)
        inputs[:n] = u[done : done + n]
        inputs[n:] = inputs[n - 1]
        run()
        x[done + 1 : done + 1 + n] = out[:n]
        now[:] = out[n - 1]
    return x


def evaluate(function: ca.Function, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """``function(x, u)`` at every row, shape (n, n_out)."""
    n = len(x)
    out = np.empty((n, function.size1_out(0)))
    if n:
        arguments = [np.ascontiguousarray(x, dtype=float), np.ascontiguousarray(u, dtype=float)]
        bind(_mapped(function, n), arguments, out)()
    return out


@lru_cache(maxsize=32)
def _repeated(step: ca.Function, count: int) -> ca.Function:
    """``count`` steps in a row; making one takes longer than running it."""
    return step.mapaccum("roll_out", count, {"base": 4})


@lru_cache(maxsize=32)
def _mapped(function: ca.Function, count: int) -> ca.Function:
    return function.map(count)


def bind(function: Any, arguments: Sequence[np.ndarray], *results: np.ndarray) -> Callable[[], None]:
    """A call that reads the argument arrays and writes the result arrays in place (rows are samples).

    Raises ParameterError for an array that does not hold doubles one behind the other, which would be misread.
    """
    for array in (*arguments, *results):
        if array.dtype != np.float64 or not array.flags.c_contiguous:
            raise ParameterError(
                f"an array of shape {array.shape} holds {array.dtype}; expected doubles one behind the other: make it "
                "by np.ascontiguousarray(..., dtype=float)"
            )
    buffer, run = function.buffer()
    for i, array in enumerate(arguments):
        buffer.set_arg(i, array.data)
    for i, array in enumerate(results):
        buffer.set_res(i, array.data)

    def call(keep: Any = (buffer, function)) -> None:  # they must outlive the call
        run()

    return call
