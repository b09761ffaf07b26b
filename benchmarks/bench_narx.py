"""NARX with three layers of 50 ELU neurons: free run and training, ours beside peers.

Free run: the same weights and input for all, na = 3, nb = 2; double precision; one thread; peers that are slow run
fewer samples. Training: 800 samples of the Narendra-Parthasarathy system, so 797 windows, Adam at 1e-3, batches of 99,
one-step-ahead; without compiling and importing, our early-stopping free runs included. Rates are medians over rounds in
turn, by processor time on one core, as others may share the machine. sysidentpy, deepSI and PyTorch are used where
they are installed beside slipangle.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from slipangle.codegen import compiler as compiled
from slipangle.data.dataset import Dataset
from slipangle.identify.networks.narx import NARX
from slipangle.identify.networks.problem import Stage
from slipangle.models.black_box.narx import NARXModel
from slipangle.models.black_box.networks import MLP
from slipangle.models.model import Model
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._peers import absent, in_turn, installed, median_record, one_core
from slipangle.reproduce.plants import narendra

SAMPLES, ROUNDS = 1_000_000, 7
EPOCHS, BATCH = 600, 99
FREE_RUN_BOUND, TRAINING_BOUND = 0.9e6, 900.0
HIDDEN = (50, 50, 50)


def bench(progress: Progress) -> Reproduction:
    """Free run in samples per second, training in epochs per second."""
    with one_core():
        records = free_runs(lambda share, what: progress(0.5 * share, what))
        records += trainings(lambda share, what: progress(0.5 + 0.5 * share, what))
    return Reproduction(
        title="NARX, 3 x 50 ELU: free run and training",
        records=tuple(records),
        protocol=(
            f"Free run of {SAMPLES} samples (slow peers fewer), same weights and input; training on 797 windows in "
            f"batches of {BATCH}, Adam. Ours: {compiled.sentence()}. Processor time on one core, medians over "
            f"{ROUNDS} rounds in turn."
        ),
    )


# ---- free run ------------------------------------------------------------------------------------------------------


def network() -> NARXModel:
    """Random weights, scaled down so that the free run stays bounded."""
    net = MLP.random((5, *HIDDEN, 1), activation="elu", seed=0)
    return NARXModel(network=net, na=3, nb=2, dt=1.0, inputs=("u",), outputs=("y",))


def free_runs(progress: Progress) -> list[Record]:
    """Every way to run the same network freely."""
    model = network()
    u = np.random.default_rng(0).uniform(-1, 1, SAMPLES)
    data = Dataset.from_arrays({"u": u}, {"y": np.zeros(SAMPLES)}, 1.0)
    short = data.head(20_000)
    runs: dict[str, tuple[Callable[[], np.ndarray], int]] = {
        "slipangle": (lambda: model.simulate(data).y[:, 0], SAMPLES),
        "slipangle without a compiler": (lambda: virtual_machine(model, short), short.n_samples),
        "NumPy loop": (lambda: numpy_loop(model, u[:5_000]), 5_000),
        "JAX scan": (jax_scan(model, u), SAMPLES),
    }
    torch = installed("torch")
    if torch:
        runs["PyTorch loop"] = (lambda: torch_loop(torch, model, u[:5_000]), 5_000)
    if torch and installed("sysidentpy"):
        runs["sysidentpy NARXNN"] = (sysidentpy_free_run(torch, u[:3_000]), 3_000)
    if torch and installed("deepSI"):
        runs["deepSI SUBNET"] = (deepsi_free_run(torch, u[:5_000]), 5_000)
    rates, results = in_turn(runs, progress, rounds=ROUNDS, clock=time.process_time)
    exact = results["slipangle"]

    def note(name: str) -> str:
        if not len(results[name]):
            return "its own random weights, layers of the same size"
        return f"largest difference {np.abs(results[name] - exact[: len(results[name])]).max():.1g}"

    return [
        median_record(
            f"free run, {name}",
            "samples/s, median",
            rate,
            bound=f">= {FREE_RUN_BOUND:g}" if name == "slipangle" else "",
            note=note(name),
        )
        for name, rate in rates.items()
    ] + absent(("torch", "sysidentpy", "deepSI"), "free run")


def virtual_machine(model: NARXModel, data: Dataset) -> np.ndarray:
    """The same model on CasADi's virtual machine."""
    x0 = model.initial_state(data.head(3))
    return np.concatenate([data["y"][:3], Model.free_run(model, x0, data.u[2:])[:, 0]])


def numpy_loop(model: NARXModel, u: np.ndarray) -> np.ndarray:
    """One matrix product per layer and sample."""
    layers = list(zip(model.network.weights, model.network.biases, strict=True))  # type: ignore[attr-defined]
    y = np.zeros(len(u))
    for k in range(3, len(u)):
        z = np.array([y[k - 1], y[k - 2], y[k - 3], u[k - 1], u[k - 2]])
        for w, b in layers[:-1]:
            z = w @ z + b
            z = np.where(z > 0, z, np.expm1(np.minimum(z, 0)))
        y[k] = (layers[-1][0] @ z + layers[-1][1])[0]
    return y


def jax_scan(model: NARXModel, u: np.ndarray) -> Callable[[], np.ndarray]:
    """A compiled scan, in double precision."""
    import jax
    import jax.numpy as jnp

    from slipangle.identify.networks import adam

    net: Any = model.network

    @jax.jit
    def run(weights: Any, biases: Any, u: Any) -> Any:
        def step(past: Any, k: Any) -> tuple[Any, Any]:
            z = jnp.concatenate([past, u[k - 1][None], u[k - 2][None]])
            for w, b in zip(weights[:-1], biases[:-1], strict=True):
                z = jax.nn.elu(w @ z + b)
            y = weights[-1] @ z + biases[-1]
            return jnp.concatenate([y, past[:2]]), y[0]

        return jax.lax.scan(step, jnp.zeros(3), jnp.arange(3, len(u)))[1]

    def call() -> np.ndarray:
        with adam.precision("double"):
            y = run(*adam.to_device((net.weights, net.biases, u)))
            return np.concatenate([np.zeros(3), np.asarray(y)])

    call()  # compile
    return call


def torch_loop(torch: Any, model: NARXModel, u: np.ndarray) -> np.ndarray:
    """One call of a PyTorch module per sample."""
    torch.set_num_threads(1)
    net = torch_module(torch, model)
    y = np.zeros(len(u))
    with torch.no_grad():
        for k in range(3, len(u)):
            y[k] = net(torch.tensor([y[k - 1], y[k - 2], y[k - 3], u[k - 1], u[k - 2]], dtype=torch.float64)).item()
    return y


def torch_module(torch: Any, model: NARXModel) -> Any:
    """The same network in PyTorch, double precision."""
    parts: list[Any] = []
    net: Any = model.network
    for k, (w, b) in enumerate(zip(net.weights, net.biases, strict=True)):
        layer = torch.nn.Linear(w.shape[1], w.shape[0], dtype=torch.float64)
        with torch.no_grad():
            layer.weight.copy_(torch.tensor(np.array(w)))
            layer.bias.copy_(torch.tensor(np.array(b)))
        parts += [layer] if k == len(net.weights) - 1 else [layer, torch.nn.ELU()]
    return torch.nn.Sequential(*parts)


# ---- training ------------------------------------------------------------------------------------------------------


def trainings(progress: Progress) -> list[Record]:
    """Epochs per second of every trainer."""
    data = narendra.estimation()
    settings = NARX(
        na=3,
        nb=2,
        hidden=HIDDEN,
        stages=(Stage(horizon=1, epochs=EPOCHS, batch=BATCH, patience=EPOCHS),),
        holdout=0.0,
    )
    settings.fit(data)  # compile

    def ours() -> np.ndarray:
        return settings.fit(data).network.parameters

    runs: dict[str, tuple[Callable[[], np.ndarray], int]] = {"slipangle": (ours, EPOCHS)}
    torch, sysidentpy = installed("torch"), installed("sysidentpy")
    if torch:
        runs["PyTorch loop"] = (lambda: torch_training(torch, data, 40), 40)
    if torch and sysidentpy:
        runs["sysidentpy NARXNN"] = (lambda: sysidentpy_training(torch, data, 40), 40)
    rates, _ = in_turn(runs, progress, rounds=ROUNDS, clock=time.process_time)
    return [
        median_record(
            f"training, {name}",
            "epochs/s, median",
            rate,
            bound=f">= {TRAINING_BOUND:g}" if name == "slipangle" else "",
        )
        for name, rate in rates.items()
    ] + absent(("torch", "sysidentpy"), "training")


def torch_training(torch: Any, data: Dataset, epochs: int) -> np.ndarray:
    """The usual PyTorch loop, single precision, one thread."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    y, u = data["y"], data["u"]
    x = np.column_stack([y[2:-1], y[1:-2], y[:-3], u[2:-1], u[1:-2]])
    x, target = (torch.tensor(a, dtype=torch.float32) for a in (x, y[3:, None]))
    sizes = (5, *HIDDEN)
    parts: list[Any] = []
    for a, b in pairwise(sizes):
        parts += [torch.nn.Linear(a, b), torch.nn.ELU()]
    net = torch.nn.Sequential(*parts, torch.nn.Linear(HIDDEN[-1], 1))
    adam = torch.optim.Adam(net.parameters(), lr=1e-3)
    for _ in range(epochs):
        order = torch.randperm(len(x))
        for rows in order.split(BATCH):
            adam.zero_grad()
            loss = torch.mean((net(x[rows]) - target[rows]) ** 2)
            loss.backward()
            adam.step()
    return np.concatenate([p.detach().numpy().ravel() for p in net.parameters()])


def sysidentpy_training(torch: Any, data: Dataset, epochs: int) -> np.ndarray:
    """The trainer of sysidentpy."""
    narxnn(torch, epochs).fit(X=data.u, y=data.y)
    return np.empty(0)


def sysidentpy_free_run(torch: Any, u: np.ndarray) -> Callable[[], np.ndarray]:
    """Free run of a network that sysidentpy trained for one epoch."""
    data = narendra.estimation()
    trained = narxnn(torch, 1)
    trained.fit(X=data.u, y=data.y)

    def call() -> np.ndarray:
        trained.predict(X=u[:, None], y=np.zeros((3, 1)))
        return np.empty(0)

    return call


def narxnn(torch: Any, epochs: int) -> Any:
    """Estimator of sysidentpy with the same layers."""
    from sysidentpy.basis_function import Polynomial  # type: ignore[import-not-found]
    from sysidentpy.neural_network import NARXNN  # type: ignore[import-not-found]

    torch.set_num_threads(1)
    torch.manual_seed(0)
    layers = [torch.nn.Linear(5, 50), *(torch.nn.Linear(50, 50) for _ in range(2)), torch.nn.Linear(50, 1)]

    class Net(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layers = torch.nn.ModuleList(layers)

        def forward(self, x: Any) -> Any:
            for layer in self.layers[:-1]:
                x = torch.nn.functional.elu(layer(x))
            return self.layers[-1](x)

    return NARXNN(
        net=Net(),
        ylag=3,
        xlag=2,
        basis_function=Polynomial(degree=1),
        model_type="NARMAX",
        loss_func="mse_loss",
        optimizer="Adam",
        epochs=epochs,
        batch_size=BATCH,
        learning_rate=1e-3,
        verbose=False,
    )


def deepsi_free_run(torch: Any, u: np.ndarray) -> Callable[[], np.ndarray]:
    """Free run of a deepSI state-space model with three states and three layers of 50 in its transition."""
    import deepSI  # type: ignore[import-not-found]
    from deepSI.networks import MLP_res_net  # type: ignore[import-not-found]

    torch.set_num_threads(1)
    data = deepSI.Input_output_data(u=u, y=np.zeros(len(u)), sampling_time=1.0)
    first = narendra.estimation()
    nu, ny, norm = deepSI.get_nu_ny_and_auto_norm(
        deepSI.Input_output_data(u=first["u"], y=first["y"], sampling_time=1.0)
    )
    f = norm.f(MLP_res_net(input_size=[3, nu], output_size=3, n_hidden_layers=3, n_hidden_nodes=50))
    model = deepSI.SUBNET(nu, ny, norm, nx=3, na=3, nb=3, f=f)

    def call() -> np.ndarray:
        with torch.no_grad():
            model.simulate(data)
        return np.empty(0)

    return call
