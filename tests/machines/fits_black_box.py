"""Linear models, Lur'e systems and networks, on the thesis' and public data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.public.sets import public
from slipangle.identify.linear.polynomial import ARMAX, OutputError
from slipangle.identify.linear.statespace import StateSpace
from slipangle.identify.lure.lure import Lure
from slipangle.identify.networks.narx import NARX
from slipangle.identify.networks.narx_free_run import FreeRunNARX
from slipangle.identify.networks.neural_statespace import NeuralStateSpace
from slipangle.identify.networks.problem import Stage
from slipangle.models.model import Model
from slipangle.reproduce import table_4_1, table_4_2, table_4_5
from slipangle.reproduce.plants import narendra
from tests.identify.networks.test_neural_statespace import duffing
from tests.machines.registry import Errors, fit


def free_run(model: Model, train: Dataset, test: Dataset) -> Errors:
    """Free-run RMSE on both parts, summed over the outputs in standard deviations of the training data."""
    scale = np.std(train.select(outputs=model.outputs).y, axis=0)
    found = {}
    for key, part in (("train", train), ("validation", test)):
        run = model.simulate(part)
        found[key] = float(np.sqrt(np.mean((run.error[run.predicted] / scale) ** 2)))
    return found


def arm() -> tuple[Dataset, Dataset]:
    """Robot arm of table 4.1."""
    return public("robot-arm").split(0.85)


@fit("state space, robot arm")
def _() -> Errors:
    train, test = arm()
    return free_run(StateSpace(order=6, focus="simulation", direct=True, max_radius=1.0).fit(train), train, test)


@fit("state space, N4SID and order by cross-validation, robot arm")
def _() -> Errors:
    train, test = arm()
    return free_run(StateSpace(order=(4, 5, 6), focus="prediction", algorithm="n4sid").fit(train), train, test)


@fit("OE, robot arm")
def _() -> Errors:
    train, test = arm()
    return free_run(OutputError(nb=6, nf=6).fit(train), train, test)


@fit("ARMAX, robot arm")
def _() -> Errors:
    train, test = arm()
    return free_run(ARMAX(na=4, nb=5, nc=2).fit(train), train, test)


def lure(name: str) -> Errors:
    """A structure of table 4.1; RMSE x 1e4."""
    train, test = arm()
    model = table_4_1._fit(table_4_1.candidates()[name], train)
    assert isinstance(table_4_1.candidates()[name], Lure)
    scores = [1e4 * table_4_1._score(model, part).rmse for part in (train, test)]
    return {"train": scores[0], "validation": scores[1], "radius": model.radius}  # type: ignore[attr-defined]


@fit("Lure, robot arm, table 4.1", most={"validation": table_4_1.BOUND, "radius": 0.99991})
def _() -> Errors:
    return lure("order 6, 1 hardening branch")


@fit("Lure with a saturation, robot arm", most={"radius": 0.99991})
def _() -> Errors:
    return lure("order 6, 1 saturation branch")


@fit("black box, EMPS, table 4.5")
def _() -> Errors:
    train, test = table_4_5.with_velocity(public("emps")).split(0.6)
    train, test = (part.select(outputs=["q", "v"]) for part in (train, test))
    return free_run(replace(table_4_5.black_box(), order=3).fit(train), train, test)


@fit("NARX, table 4.2, 1000 epochs", most={"RMSE": table_4_2.BEST_BOUND})
def _() -> Errors:
    train, test = narendra.estimation(seed=2), narendra.validation()
    stages = tuple(replace(stage, epochs=1000) for stage in table_4_2.settings(2).stages)
    model = replace(table_4_2.settings(2), stages=stages).fit(train)
    run = model.simulate(test)
    found = free_run(model, train, test)
    return {**found, "RMSE": float(np.sqrt(np.mean(run.error[run.predicted] ** 2)))}


@fit("NARX over 20 steps, robot arm")
def _() -> Errors:
    train, test = arm()
    stages = (Stage(epochs=300), Stage(horizon=20, epochs=300))
    return free_run(
        NARX(na=5, nb=5, hidden=(12,), activation="tanh", stages=stages, seeds=(0, 1)).fit(train), train, test
    )


@fit("NARX by its free run, Narendra")
def _() -> Errors:
    train, test = narendra.estimation(seed=1), narendra.validation()
    start = NARX(
        na=3, nb=2, hidden=(8,), activation="tanh", stages=(Stage(epochs=300, learning_rate=5e-3),), seeds=(0, 1)
    )
    return free_run(FreeRunNARX(start=start).fit(train), train, test)


@fit("neural state space, hardening spring")
def _() -> Errors:
    train, test = duffing(), duffing(seed=1)
    stages = (Stage(horizon=20, epochs=400, learning_rate=5e-3),)
    return free_run(NeuralStateSpace(order=2, hidden=(16,), stages=stages).fit(train), train, test)
