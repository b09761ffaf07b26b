"""Free run of the bicycle with a network inside: compiled, beside the same model on CasADi's virtual machine.

Magic Formula axles with load transfer, two Runge-Kutta steps per sample, six inputs to the network, 24 neurons: the
size of table 8.2's. Steering and speed of a lively drive, one thread, in turn; process time of the whole `simulate`.
"""

from __future__ import annotations

import time

import numpy as np

from slipangle.codegen.compiler import sentence
from slipangle.data.dataset import Dataset
from slipangle.models.black_box.networks import MLP, Scaling
from slipangle.models.vehicles.neural_bicycle import LONG, NeuralBicycle, TireNetworkBicycle
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycleParams
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

ROUNDS, SAMPLES = 15, 11_000
CAR = NonlinearBicycleParams(mass=982.0, inertia_z=900.0, wheelbase=2.4, l_f=1.3, C_f=6e4, C_r=9e4)


def model(kind: type[NeuralBicycle]) -> NeuralBicycle:
    """A car with random weights."""
    n, _ = kind.network_outputs
    network = MLP.random(
        (6, 24, n),
        activation="tanh",
        seed=0,
        input_scaling=Scaling(offset=[0.0, 0.0, 0.0, 0.0, 25.0, 0.0], factor=[1.0, 0.4, 0.05, 0.05, 15.0, 4.0]),
        output_scaling=Scaling(offset=[0.0] * n, factor=[0.1] * n),
    )
    return kind(params=CAR, network=network, dt=0.05, substeps=2)


def bench(progress: Progress) -> Reproduction:
    """Samples per second of each, and how far they agree."""
    t = np.arange(SAMPLES) * 0.05
    v_x = 25 + 8 * np.sin(0.11 * t)
    inputs = {"delta": 0.05 * np.sin(0.9 * t), "v_x": v_x, "v_x_dot": np.gradient(v_x, 0.05)}
    data = Dataset.from_arrays(inputs, {"r": np.zeros(SAMPLES)}, 0.05)
    few = LONG - 1  # too short a run for compiled code
    short = [data.rows(a, a + few) for a in range(0, SAMPLES - few, few)]
    found: list[Record] = []
    for k, (name, kind) in enumerate({"on the derivative": NeuralBicycle, "on the tires": TireNetworkBicycle}.items()):
        car = model(kind)
        whole = car.simulate(data).y
        same = car.simulate(short[0]).y
        spent: dict[str, list[float]] = {"compiled": [], "virtual machine": []}
        for i in range(ROUNDS):
            progress((k + i / ROUNDS) / 2, f"network {name}, round {i + 1}")
            began = time.process_time()
            car.simulate(data)
            spent["compiled"].append((time.process_time() - began) / SAMPLES)
            part = short[i % len(short)]
            began = time.process_time()
            car.simulate(part)
            spent["virtual machine"].append((time.process_time() - began) / few)
        for how, seconds in spent.items():
            rate = 1 / float(np.median(seconds))
            asked = how == "compiled"
            found.append(
                Record(
                    row=f"network {name}, {how}",
                    quantity="free run [samples/s], median",
                    thesis=None,
                    here=rate,
                    bound=">= 100000" if asked else "",
                    holds=rate >= 1e5 if asked else None,
                    note=f"p99 {1 / np.percentile(seconds, 99):.3g} samples/s",
                )
            )
        apart = float(np.abs(whole[: len(same)] - same).max())
        found.append(
            Record(
                row=f"network {name}",
                quantity="largest difference [rad/s]",
                thesis=None,
                here=apart,
                bound="<= 1e-10",
                holds=apart <= 1e-10,
            )
        )
    return Reproduction(
        title="Free run of the bicycle with a network inside",
        records=tuple(found),
        protocol=" ".join((__doc__ or "").split()) + f" {SAMPLES} samples; {sentence()}.",
    )
