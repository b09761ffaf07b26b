"""What a reader has when the Python of a page begins: a car, its log, a path, files; one function a page."""

import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen.compiler import compiler, sentence
from slipangle.control.speed.pedals import pedal_driver
from slipangle.export.fmi import export_fmu
from slipangle.models.vehicles.catalogue import BMW_320I, PASSENGER_TIRE, SOUSA_CAR_7
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.on_tires import bicycle_on
from slipangle.workflow.drive import PlantSettings, build_plant
from tests.control.racing.test_racer import MARGIN, PEDALS, believed, circuit, first_lap
from tests.data.readers.logs import drive as drive_of_a_bag
from tests.data.readers.logs import write_bag

PARAMS = sa.BicycleParams(mass=1500, inertia_z=2500, wheelbase=2.7, l_f=1.2, C_f=9e4, C_r=1.1e5)
LIMITED = dict(mass=982, inertia_z=900, wheelbase=2.4, l_f=1.35, C_f=6e4, C_r=9e4, mu_f=1.1, mu_r=1.2)
UNITS = {"delta": "rad", "v_x": "m/s", "v_x_dot": "m/s2", "r": "rad/s", "v_y": "m/s", "a_y": "m/s2"}
COMPILED = ("README", "driving", "export", "page", "plants")  # without a compiler their loops take minutes
NOISE = {"r": 0.003, "v_y": 0.02, "a_y": 0.1}
SPEED = 20.0  # m/s


def names(page: str, folder: Path) -> dict[str, Any]:
    """What the reader of a page has, files in the folder among it; nothing where the page begins with nothing."""
    if page in COMPILED and compiler() is None:
        pytest.skip(sentence())
    make = PAGES.get(page)
    return make(folder) if make else {}


def said(page: str, known: dict[str, Any]) -> None:
    """What a page says of its results holds."""
    if page in RESULTS:
        assert RESULTS[page](known), page


def log(seconds: float = 40.0, **car_of: float) -> sa.Dataset:
    """Random steering and a swinging speed of a car near the limit, noise on what is measured."""
    params = sa.NonlinearBicycleParams(**(LIMITED | car_of))
    car = sa.NonlinearBicycle(params=params, dt=0.05, outputs=tuple(NOISE))
    rng, n = np.random.default_rng(0), round(seconds / car.dt)
    delta = 0.05 * np.convolve(np.repeat(rng.standard_normal(n // 20), 20), np.ones(9) / 9, "same")
    v_x = SPEED + 4.0 * np.sin(0.3 * car.dt * np.arange(n))
    inputs = {"delta": delta, "v_x": v_x, "v_x_dot": np.gradient(v_x, car.dt)}
    data = sa.Dataset.from_arrays(inputs, {name: np.zeros(n) for name in NOISE}, car.dt, units=UNITS)
    y = car.simulate(data).y + list(NOISE.values()) * rng.standard_normal((n, len(NOISE)))
    for name, column in zip(NOISE, y.T, strict=True):
        data = data.with_channel(name, column, UNITS[name])
    return data.select(inputs=("delta", "v_x"), outputs=tuple(NOISE))


def bicycle(dt: float = 0.02, outputs: tuple[str, ...] = ("r",)) -> sa.Bicycle:
    """The linear bicycle of the pages' road car."""
    return sa.Bicycle(params=PARAMS, dt=dt, outputs=outputs)


def steering(model: sa.Model) -> sa.MPC:
    """An MPC that steers."""
    return sa.MPC(
        sa.OnGround(model),
        horizon=20,
        controls=("delta",),
        Q=sa.Weights(X=0.1, Y=1.0, psi=1.0),
        S=sa.Weights(delta=50.0),
        limits=sa.Limits(delta=0.35),
    )


def write_run(path: Path) -> None:
    """`run.csv`: steering, speed and yaw rate of a road car in the units of people, two minutes at 20 Hz."""
    rng, n = np.random.default_rng(0), 2400
    delta = 0.03 * np.convolve(np.repeat(rng.standard_normal(n // 20), 20), np.ones(8) / 8, "same")
    v_x = 15 + 4 * np.sin(0.01 * np.arange(n))
    params = sa.BicycleParams(mass=1200, inertia_z=1600, wheelbase=2.6, l_f=1.2, C_f=8e4, C_r=9e4)
    car = sa.Bicycle(params=params, dt=0.05, outputs=("r",))
    drive = sa.Dataset.from_arrays({"delta": delta, "v_x": v_x}, {"r": np.zeros(n)}, 0.05)
    r = car.simulate(drive).y[:, 0] + 0.003 * rng.standard_normal(n)
    table = np.column_stack([0.05 * np.arange(n), np.rad2deg(delta), 3.6 * v_x, np.rad2deg(r)])
    head = "t [s],steer [deg],speed [km/h],yaw rate [deg/s]"
    np.savetxt(path, table, delimiter=",", header=head, comments="")


# ---- pages ---------------------------------------------------------------------------------------------------------


def readme(folder: Path) -> dict[str, Any]:
    """A log, and a path to drive along."""
    write_run(folder / "run.csv")
    return {"path": sa.double_lane_change(SPEED)}


def choosing_a_model(folder: Path) -> dict[str, Any]:
    """The log of a car at the limit."""
    return {"data": log().select(inputs=("delta", "v_x"), outputs=("r",))}


def driving(folder: Path) -> dict[str, Any]:
    """A model, a car with pedals, a controller, logs to learn from, what `identify_car` finds."""
    train, test = log(120.0).split(0.7)
    plant = DualTrack(params=SOUSA_CAR_7, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001)
    same = bicycle_on(SOUSA_CAR_7, PASSENGER_TIRE)
    known = {name: getattr(same, name) for name in ("mass", "wheelbase", "l_f")}
    like = log(30.0, **known, **{name: getattr(same, name) for name in ("inertia_z", "C_f", "C_r")})
    return {
        "bicycle": bicycle(),
        "plant": sa.Plant(plant),
        "speed_driver": pedal_driver(SOUSA_CAR_7),
        "controller": steering(bicycle(dt=0.04)),
        "path": sa.double_lane_change(SPEED),
        "train": train,
        "test": test,
        "found": sa.identify_car(like, **known),
    }


def exported(folder: Path) -> dict[str, Any]:
    """One of everything that becomes C, and a moment to plan from."""
    car, path = bicycle(dt=0.05), sa.double_lane_change(SPEED)
    mpc, data = steering(car), log(120.0)
    return {
        "mpc": mpc,
        "model": car,
        "driver": sa.Driver(bicycle(), path, noise={"r": 0.003}),
        "racer": sa.Racer(believed(), circuit(), PEDALS, lap=first_lap(), margin=MARGIN, between="sectors"),
        "ekf": sa.EKF(start=car, noise_std={"r": 0.003}, process_std={"v_y": 0.1}),
        "recursive": sa.RLS(na=2, nb=2).start(inputs="delta", outputs="r", dt=0.05),
        "sensor": sa.SideSlipSensor(wheelbase=2.4, l_f=1.35).fit(data),
        "plant": sa.Plant(sa.OnGround(bicycle(dt=0.01))),
        "path": path,
        "x": mpc.model.straight(SPEED),
        "reference": mpc.reference(path.ahead(0.0, mpc.times)),
        "plan": None,
    }


def logs(folder: Path) -> dict[str, Any]:
    """A file of a robot."""
    pytest.importorskip("rosbags")
    made = write_bag(folder / "bag", drive_of_a_bag(), ros=3)
    shutil.copy(next(made.glob("*.mcap")), folder / "drive.mcap")
    return {}


def page(folder: Path) -> dict[str, Any]:
    """The closed loop of a job."""
    plant, driver, _ = build_plant(PlantSettings(), bicycle(dt=0.05, outputs=("v_y", "r")))
    mpc = steering(bicycle(dt=0.05, outputs=("v_y", "r")))
    return {"plant": plant, "mpc": mpc, "path": sa.double_lane_change(15.0), "speed_driver": driver}


def plants(folder: Path) -> dict[str, Any]:
    """A controller and a driver; the FMU of a car whose variables have names of their own."""
    path = sa.double_lane_change(SPEED)
    write_foreign_fmu(folder / "car.fmu")
    return {"mpc": steering(bicycle(dt=0.05)), "driver": sa.Driver(bicycle(), path, noise={"r": 0.003})}


def tires(folder: Path) -> dict[str, Any]:
    """A tire file, a car, and a log of a car on these tires."""
    PASSENGER_TIRE.write_tir(folder / "tire.tir")
    known = sa.TireBicycleParams(mass=1500, inertia_z=2500, wheelbase=2.7, l_f=1.2, LMUY_f=0.9, LKY_r=1.1)
    car = sa.TireBicycle(params=known, dt=0.05, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE)
    rng, n = np.random.default_rng(0), 800
    delta = 0.06 * np.convolve(np.repeat(rng.standard_normal(n // 20), 20), np.ones(9) / 9, "same")
    drive = {"delta": delta, "v_x": SPEED + 3.0 * np.sin(0.02 * np.arange(n))}
    empty = {name: np.zeros(n) for name in car.outputs}
    data = sa.Dataset.from_arrays(drive, empty, car.dt, units=UNITS)
    y = car.simulate(data).y
    for name, column in zip(car.outputs, y.T, strict=True):
        data = data.with_channel(name, column + NOISE[name] * rng.standard_normal(n), UNITS[name])
    return {"params": BMW_320I, "train": data}


def write_foreign_fmu(path: Path) -> None:
    """An FMU of a car of ours whose description names its variables, and starts apart, as another tool would."""
    made = export_fmu(sa.OnGround(bicycle(dt=0.001)), path.with_name("ours.fmu"))
    named = {"delta": "SteeringAngle", "v_x": "WantedSpeed", "r": "yaw_rate", "X": "pos.x", "Y": "pos.y", "psi": "yaw"}
    named |= {"state.X": "x0", "state.Y": "y0", "state.psi": "yaw0"}
    with zipfile.ZipFile(made) as ours, zipfile.ZipFile(path, "w") as other:
        for name in ours.namelist():
            content = ours.read(name)
            if name == "modelDescription.xml":
                text = content.decode()
                for old, new in named.items():
                    text = text.replace(f'<ScalarVariable name="{old}"', f'<ScalarVariable name="{new}"')
                content = _aliased(text, "WantedSpeed", "speed", "v0").encode()
            other.writestr(name, content)


def _aliased(text: str, name: str, *others: str) -> str:
    """The description with more names for a variable."""
    (line,) = (line for line in text.splitlines() if f'name="{name}"' in line)
    more = [line.replace(f'name="{name}"', f'name="{other}"').replace('"input"', '"local"') for other in others]
    return text.replace("  </ModelVariables>", "\n".join([*more, "  </ModelVariables>"]))


PAGES: dict[str, Callable[[Path], dict[str, Any]]] = {
    "README": readme,
    "choosing-a-model": choosing_a_model,
    "driving": driving,
    "export": exported,
    "logs": logs,
    "page": page,
    "plants": plants,
    "tires": tires,
}
RESULTS: dict[str, Callable[[dict[str, Any]], bool]] = {
    "README": lambda n: (
        n["mpc"].horizon == 20 and all(Path(made, "Makefile").exists() for made in ("pilot", "controller"))
    ),
    "choosing-a-model": lambda n: sa.validate(n["model"], n["test"]).free_run_scores["r"].fit > 90,
    "driving": lambda n: n["run"].inside and n["sensor"].std < 0.01,
    "export": lambda n: abs(n["plan"].command - n["mpc"].plan(n["x"], n["reference"]).command).max() < 1e-9,
    "fastest-lap": lambda n: n["run"].inside,
    "logs": lambda n: abs(n["log"].signal("/speed.data").dt - 0.1) < 1e-6 and n["data"].dt == 0.02,
    "page": lambda n: n["run"].inside and (n["program"] is None or isinstance(n["program"], bytes)),
    "plants": lambda n: n["run"].inside,
    "tires": lambda n: abs(n["model"].value("LMUY_f") - 0.9) < 0.05 and abs(n["model"].value("LKY_r") - 1.1) < 0.1,
}
