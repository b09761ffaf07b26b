"""Plants that are no models: driven as the model that stands inside, in this process and in another one."""

import contextlib
import json
import socket
import threading

import numpy as np
import pytest

import slipangle as sa
from slipangle.control.followers.followers import Stanley
from slipangle.errors import ConfigError, FormatError, NotFiniteError, ParameterError, SimulationError
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.terms import Values
from slipangle.paths.lane_change import double_lane_change
from slipangle.simulate.foreign import PlantFunctions
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.manoeuvres import record, step_steer
from slipangle.simulate.plant import Plant
from slipangle.simulate.process import PlantProcess, local_address, serve
from slipangle.simulate.run import End
from slipangle.simulate.sensors import Sensor, Sensors

CAR = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.005))
FOLLOWER = Stanley(params=SOUSA_TABLE_7_2)
PATH = double_lane_change(14.0)


class Elsewhere:
    """A bicycle behind the protocol; it loses what `lost(k)` names at step k."""

    dt, inputs, outputs = 0.005, ("delta", "v_x"), ("v_y", "r", "X", "Y", "psi", "v_x")

    def __init__(self, lost=lambda k: ()):
        self.lost, self.k = lost, 0

    def reset(self, start):
        self.x, self.v_x = np.array([0.0, 0.0, start["X"], start["Y"], start["psi"]]), start["v_x"]
        return self.measured()

    def step(self, commands):
        self.k += 1
        self.v_x = commands["v_x"]
        self.x = np.array(CAR.functions[0](self.x, [commands["delta"], self.v_x])).ravel()
        return {n: v for n, v in self.measured().items() if n not in self.lost(self.k)}

    def measured(self):
        return dict(zip(self.outputs, (*self.x.tolist(), self.v_x), strict=True))


def same(a, b):
    assert a.end is b.end
    assert a.t == pytest.approx(b.t)
    for name in ("e_y", "e_psi", "s"):
        assert getattr(a, name) == pytest.approx(getattr(b, name), abs=1e-9)
    assert a.commands == pytest.approx(b.commands, abs=1e-9)


@pytest.fixture(scope="module")
def of_model():
    return closed_loop(Plant(CAR, delay=Values(delta=0.02), lag=Values(delta=0.05)), FOLLOWER, PATH)


def test_an_object_is_driven_as_the_model_inside(of_model):
    run = closed_loop(Plant(Elsewhere(), delay=Values(delta=0.02), lag=Values(delta=0.05)), FOLLOWER, PATH)
    same(run, of_model)
    assert run.end is End.FINISHED
    assert "v_y" in run.state_names


def test_functions_are_a_plant(of_model):
    car = Elsewhere()
    functions = PlantFunctions(step=car.step, reset=car.reset, dt=car.dt, inputs=car.inputs, outputs=car.outputs)
    same(closed_loop(Plant(functions, delay=Values(delta=0.02), lag=Values(delta=0.05)), FOLLOWER, PATH), of_model)


def test_it_is_logged_and_sensed_as_a_model():
    manoeuvre = step_steer(14.0, 0.02, duration=2.0, start=0.2)
    sensors = Sensors(r=Sensor(noise=0.01, interval=0.02))
    theirs = record(Plant(Elsewhere(), sensors=sensors, seed=3), manoeuvre, channels=("r", "v_y"))
    ours = record(Plant(CAR, sensors=sensors, seed=3), manoeuvre, channels=("r", "v_y"))
    assert theirs["v_y"] == pytest.approx(ours["v_y"], abs=1e-12)
    assert np.std(theirs["r"] - theirs["v_y"] * 0) > 0
    assert len(np.unique(theirs["r"])) == pytest.approx(len(theirs["r"]) / 2, abs=2)


def test_what_is_missing_is_nan_and_the_last_value_is_held():
    simulation = Plant(Elsewhere(lost=lambda k: ("r",) if k == 2 else ())).start(np.zeros(6), np.array([0.05, 10.0]))
    simulation.advance(np.array([0.05, 10.0]), 1)
    last = simulation.measure()["r"]
    simulation.advance(np.array([0.05, 10.0]), 1)
    assert np.isnan(simulation.measure()["r"])
    assert simulation.true()["r"] == last
    simulation.advance(np.array([0.05, 10.0]), 1)
    assert simulation.measure()["r"] > last


def test_a_plant_that_is_never_seen_again_ends_the_drive():
    run = closed_loop(Plant(Elsewhere(lost=lambda k: ("X", "Y") if k > 200 else ())), FOLLOWER, PATH)
    assert run.end is End.NOT_FINITE
    assert 3.0 <= run.t[-1] <= 3.1


@pytest.mark.parametrize(
    ("thing", "said"),
    [
        (object(), "lacks dt, inputs, outputs, reset\\(\\), step\\(\\)"),
        (lambda commands: commands, "the function <lambda>.*PlantFunctions"),
        (Elsewhere, "the class Elsewhere; expected an object"),
        (type("Odd", (Elsewhere,), {"dt": 0.0})(), "dt of the plant Odd is 0.0"),
        (type("Odd", (Elsewhere,), {"inputs": "delta"})(), "inputs of the plant Odd are 'delta'"),
        (type("Odd", (Elsewhere,), {"outputs": ("r", "r")})(), "expected a tuple of different names"),
        (type("Odd", (Elsewhere,), {"step": None})(), "lacks step\\(\\)"),
    ],
)
def test_it_says_what_a_plant_lacks(thing, said):
    with pytest.raises(ParameterError, match=said):
        sa.Plant(thing)


@pytest.mark.parametrize(
    ("step", "kind", "said"),
    [
        (lambda commands: 1 / 0, SimulationError, "failed in step\\(\\): ZeroDivisionError"),
        (lambda commands: [0.0], ParameterError, "expected a dict of measurements"),
        (lambda commands: {"X": "here"}, ParameterError, "expected a number, None or NaN"),
    ],
)
def test_what_a_plant_does_wrong_is_one_sentence(step, kind, said):
    car = Elsewhere()
    car.step = step
    with pytest.raises(kind, match=said):
        closed_loop(Plant(car), FOLLOWER, PATH)


def test_reset_answers_every_output():
    car = Elsewhere()
    car.reset = lambda start: {"X": 0.0}
    with pytest.raises(NotFiniteError, match="reset without a number for"):
        closed_loop(Plant(car), FOLLOWER, PATH)


# ---- another process -----------------------------------------------------------------------------------------------


def served(plant):
    """Address of a plant that a thread serves, and the thread."""
    told = []
    heard = threading.Event()
    thread = threading.Thread(
        target=serve, args=(plant,), kwargs={"ready": lambda a: (told.append(a), heard.set())}, daemon=True
    )
    thread.start()
    assert heard.wait(10.0)
    return told[0], thread


def test_over_a_socket_it_is_the_same_drive(of_model):
    address, thread = served(Elsewhere())
    with PlantProcess(address) as far:
        run = closed_loop(Plant(far, delay=Values(delta=0.02), lag=Values(delta=0.05)), FOLLOWER, PATH)
    same(run, of_model)
    thread.join(10.0)
    assert not thread.is_alive()


def test_missing_channels_and_errors_cross_the_socket():
    car = Elsewhere(lost=lambda k: ("r",))
    address, _ = served(car)
    with PlantProcess(address) as far:
        far.reset({"X": 0.0, "Y": 0.0, "psi": 0.0, "v_x": 10.0})
        assert far.step({"delta": 0.0, "v_x": 10.0})["r"] is None
        with pytest.raises(SimulationError, match="KeyError"):
            far.step({"delta": 0.0})
        car.lost = lambda k: ()
        assert far.step({"delta": 0.1, "v_x": 10.0})["r"] != 0


@pytest.mark.parametrize("address", ["10.0.0.5:5005", "example.org:80", "127.0.0.1", "127.0.0.1:0", "0.0.0.0:5005"])
def test_only_this_machine(address):
    with pytest.raises(ConfigError, match="the address is"):
        PlantProcess(address)


def test_addresses():
    assert local_address("localhost:5005") == ("127.0.0.1", 5005)
    assert local_address("[::1]:5005") == ("::1", 5005)


def test_nobody_there():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(ConfigError, match="no plant answers"):
        PlantProcess(f"127.0.0.1:{port}")


@pytest.mark.parametrize(
    ("line", "kind", "said"),
    [
        (b"hello\n", FormatError, "expected one JSON object a line"),
        (b"[1]\n", FormatError, "expected one JSON object a line"),
        (b"{}\n", FormatError, "expected dt, inputs, outputs"),
        (b"", SimulationError, "closed the connection"),
        (b"x" * 200_000, FormatError, "a line of more than"),
        (b"[" * 20_000 + b"\n", FormatError, "expected one JSON object a line"),
        (json.dumps({"dt": "x", "inputs": ["a"], "outputs": ["X"]}).encode() + b"\n", ParameterError, "dt of the"),
        (json.dumps({"error": "out of petrol"}).encode() + b"\n", SimulationError, "says: out of petrol"),
    ],
)
def test_answers_that_are_not_of_the_protocol(line, kind, said):
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def answer():
            connection, _ = listening.accept()
            with connection, contextlib.suppress(OSError):  # the other side has heard enough
                connection.recv(1000)
                connection.sendall(line)
                connection.shutdown(socket.SHUT_WR)
                connection.recv(1000)

        thread = threading.Thread(target=answer, daemon=True)
        thread.start()
        with pytest.raises(kind, match=said) as caught:
            PlantProcess(f"127.0.0.1:{listening.getsockname()[1]}", patience=5.0)
        thread.join(10.0)
    assert len(str(caught.value)) < 300
