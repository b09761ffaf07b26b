"""OnGround: consistent kinematics, second order, symbols equal numbers, clear errors."""

from dataclasses import dataclass

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.model import Model
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2, SOUSA_TABLE_7_2
from slipangle.models.vehicles.single_track import SingleTrack
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.ops import stack

BICYCLE = Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("r", "v_y"))
ARX_R = ARXModel(
    A=np.array([[[-0.9]], [[0.1]]]), B=np.array([[[0.5]], [[0.1]]]), inputs=("delta",), outputs=("r",), dt=0.05
)


@dataclass(frozen=True)
class Beta(Model):
    """Constant side slip and yaw rate; speed and lateral motion are outputs only."""

    dt: float = 0.05
    inputs = ("delta",)
    outputs = ("r", "beta", "v_x")
    states = ("a",)

    def initial_state(self, data):
        return np.zeros(1)

    def step(self, x, u):
        return stack([x[0]])

    def output(self, x, u):
        return stack([u[0], 0.1 + 0 * x[0], 10.0 + 0 * x[0]])


MODELS = {
    "bicycle": OnGround(BICYCLE),
    "r only, zero": OnGround(ARX_R, v_y="zero"),
    "r only, rear axle": OnGround(ARX_R, v_y=1.6),
    "beta": OnGround(Beta()),
}
EVERY = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS.keys())


@EVERY
@pytest.mark.parametrize("seed", range(4))
def test_symbols_equal_numbers(model, seed):
    rng = np.random.default_rng(seed)
    x, u = rng.standard_normal(model.n_states), rng.standard_normal(model.n_inputs)
    if "v_x" in model.inputs:
        u[model.inputs.index("v_x")] = 15.0
    step, output, correct = model.functions
    y = np.asarray(model.output(x, u))
    assert np.asarray(step(x, u)).ravel() == pytest.approx(model.step(x, u), rel=1e-12, abs=1e-12)
    assert np.asarray(output(x, u)).ravel() == pytest.approx(y, rel=1e-12, abs=1e-12)
    measured = y + 1.0
    assert np.asarray(correct(x, u, measured)).ravel() == pytest.approx(model.correct(x, u, measured), rel=1e-12)
    assert model.correct(x, u, measured)[-3:] == pytest.approx(x[-3:] + 1.0)


def test_names():
    model = OnGround(BICYCLE)
    assert model.states == ("v_y", "r", "X", "Y", "psi")
    assert model.outputs == ("r", "v_y", "X", "Y", "psi")
    assert model.inputs == ("delta", "v_x")
    assert model.dt == 0.05
    assert OnGround(ARX_R, v_y="zero").inputs == ("delta", "v_x")  # the speed it does not know itself


def test_steady_circle_is_a_circle():
    """Constant v_x, v_y, r: the exact path is an arc of radius V / r."""
    model = OnGround(ARX_R, v_y=1.6)
    gain = ARX_R.B.sum() / (1 + ARX_R.A.sum())
    r = 0.3
    delta = r / gain
    x = np.zeros(model.n_states)
    x[: ARX_R.n_states] = [r, r, delta][: ARX_R.n_states]
    for _ in range(100):
        x = model.step(x, np.array([delta, 12.0]))
    angle, speed = r * 5.0, np.array([12.0, 1.6 * r])
    turn = np.array([[np.sin(angle), np.cos(angle) - 1], [1 - np.cos(angle), np.sin(angle)]]) / r
    assert x[-1] == pytest.approx(angle, abs=1e-9)
    assert x[-3:-1] == pytest.approx(turn @ speed, abs=1e-6)


def test_second_order():
    """Error against a fine integration falls with the square of the sample time."""

    def end(dt):
        model = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=dt))
        x = np.zeros(5)
        for _ in range(round(2.0 / dt)):
            x = model.step(x, np.array([0.05, 20.0]))
        return x[2:]

    exact = end(0.0005)
    errors = [np.linalg.norm(end(dt) - exact) for dt in (0.1, 0.05, 0.025)]
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(2.0, abs=0.2)
    # trapezoid of a yaw rate that starts with r' = l_f C_f delta / I_z turns the last 40 m by dt^2 r' / 12
    p = SOUSA_TABLE_7_2
    assert errors[1] < 40.0 * 0.05**2 / 12 * p.l_f * p.C_f * 0.05 / p.inertia_z


def test_r_as_state_or_output_gives_the_same_motion():
    wide, narrow = (OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=o)) for o in (("r", "v_y"), ("r",)))
    x, u = np.array([0.2, 0.1, 1.0, 2.0, 0.3]), np.array([0.02, 18.0])
    assert np.array_equal(wide.step(x, u), narrow.step(x, u))


def test_initial_state_reads_the_pose():
    n = 6
    data = Dataset.from_arrays(
        {"delta": np.zeros(n), "v_x": np.full(n, 10.0)},
        {"r": np.zeros(n), "X": np.arange(n) + 3.0, "Y": np.full(n, 2.0), "psi": np.full(n, 0.1)},
        0.05,
    )
    model = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05))
    assert model.initial_state(data.head(1))[-3:] == pytest.approx([3.0, 2.0, 0.1])
    late = OnGround(ARX_R, v_y="zero")
    assert late.initial_state(data.head(late.memory))[-3] == pytest.approx(3.0 + late.memory - 1)
    run = model.simulate(data)
    assert run.channel("X") == pytest.approx(3.0 + 0.5 * np.arange(n) * np.cos(0.1))


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: OnGround(ARX_R), 'v_y="zero"'),
        (lambda: OnGround(OnGround(BICYCLE)), "already"),
        (
            lambda: OnGround(
                SingleTrack(params=SOUSA_TABLE_6_1, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2, dt=0.001)
            ),
            "already",
        ),
        (
            lambda: OnGround(
                ARXModel(A=np.array([[[-0.9]]]), B=np.array([[[0.5]]]), inputs=("delta",), outputs=("beta",), dt=0.05)
            ),
            "yaw rate",
        ),
        (lambda: OnGround(BICYCLE, v_y="none"), "zero"),
    ],
)
def test_errors_say_what_to_do(make, what):
    with pytest.raises(ParameterError, match=what):
        make()
