"""An exported filter estimates what the one in Python does, whatever it is given, on any machine."""

import ctypes
from functools import partial

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.errors import NotFiniteError, ParameterError, SimulationError
from slipangle.export.drives import Drive
from slipangle.export.kinds import project_of
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.vehicles.load_transfer import LoadTransfer
from slipangle.models.vehicles.saturating_bicycle import RelaxingBicycle, SaturatingBicycleParams
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from tests.export.loaded import array, as_one, defines
from tests.export.tools import MACHINES, STRICT, built_and_run, needs, run

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
LIMITED = SaturatingBicycleParams(
    mass=1000.0,
    inertia_z=800.0,
    wheelbase=2.4,
    l_f=1.3,
    C_f=6e4,
    C_r=1e5,
    mu_f=0.9,
    mu_r=1.0,
    relaxation_f=0.4,
    relaxation_r=0.4,
)
CAR = Bicycle(params=SOUSA_TABLE_7_2, dt=0.02, outputs=("v_y", "r", "a_y"))


def found(substeps=0):
    """A car as it is found of hard laps: eight steps a sample unless told otherwise, of which the code has one."""
    equations = RelaxingBicycle(params=LIMITED, dt=0.02, outputs=("v_y", "r", "a_y"), substeps=substeps)
    return Delayed(Steered(LoadTransfer(equations, height=0.4), steering_lag=0.05), delays={"delta": 0.04})


NOISE = {"v_y": 0.05, "r": 0.005, "a_y": 0.2}
WANDER = {"v_y": 0.2, "r": 0.05}
VARIANTS = {
    "observer": sa.EKF(start=CAR, noise_std=NOISE, process_std=WANDER),
    "late, gate, offsets": sa.EKF(
        start=sa.OnGround(CAR),
        noise_std={**NOISE, "X": 0.1, "Y": 0.1, "psi": 0.01},
        process_std=WANDER,
        gate=4.0,
        patience=3,
        late={"X": 0.06, "Y": 0.06, "psi": 0.04},
        bias_std={"a_y": 0.3, "r": 0.01},
        bias_walk={"a_y": 0.01},
    ),
    "many steps": sa.EKF(
        start=sa.OnGround(found()),
        free=("C_f", "mu_r"),
        noise_std={"v_y": 0.05, "r": 0.005, "a_y": 0.2, "X": 0.1, "Y": 0.1, "psi": 0.01},
        process_std=WANDER,
        gate=6.0,
        bias_std={"r": 0.01},
    ),
    "one state": sa.EKF(
        start=sa.Ode(
            f=lambda x, u, p: [-p.a * x[0] + u[0] * u[1] / 20],
            states=("x",),
            inputs=("u", "v_x"),
            params={"a": 1.0},
            dt=0.1,
        ),
        noise_std={"x": 0.05},
        process_std={"x": 0.02},
        gate=5.0,
    ),
    "parameters": sa.EKF(start=CAR, free=("C_f", "C_r"), noise_std=NOISE, process_std=WANDER, walk_std={"C_f": 0.01}),
}
EACH = pytest.mark.parametrize("variant", VARIANTS)


def test_code_does_not_grow_with_the_steps(monkeypatch):
    """Of a filter, of the solver of a window, and of a model."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O0")
    known = {"noise_std": NOISE, "process_std": WANDER}
    for make in (partial(sa.EKF, **known), partial(sa.MHE, horizon=4, **known), lambda start: start):
        few, many = (project_of(make(start=found(n)), "car", 3).everything for n in (16, 48))
        assert {n: len(c.splitlines()) for n, c in few.items() if n.endswith(".c")} == {
            n: len(c.splitlines()) for n, c in many.items() if n.endswith(".c")
        }


class LoadedFilter:
    """An estimator exported under the name ``car``, called as a program in C would call it."""

    def __init__(self, files):
        n = defines(files["car.h"])
        self.Sample = type(
            "Sample", (ctypes.Structure,), {"_fields_": [("y", array(n["OUTPUTS"])), ("u", array(n["INPUTS_SIZE"]))]}
        )
        listed = [("state", n["STATES"]), ("state_std", n["STATES"])]
        listed += [("innovation", n["OUTPUTS"]), ("innovation_std", n["OUTPUTS"])]
        listed += [(k, n["PARAMETERS"]) for k in ("parameter", "parameter_std")]
        listed += [(k, n["BIASES"]) for k in ("bias", "bias_std")]
        fields = [(k, array(size)) for k, size in listed]
        self.Estimate = type(
            "Estimate", (ctypes.Structure,), {"_fields_": [*fields, ("taken", ctypes.c_int * n["OUTPUTS"])]}
        )
        self.library = compiler.library(as_one(files), name="exported")
        self.memory = np.zeros(n["BYTES"] // 8)
        self.at, self.bytes = ctypes.c_void_p(self.memory.ctypes.data), ctypes.c_size_t(n["BYTES"])

    def start(self, x, again=False):
        x = (ctypes.c_double * len(x))(*x)
        if again:
            return self.library.car_restart(self.at, x)
        self.library.car_start.argtypes = None
        return self.library.car_start(self.at, self.bytes, x)

    def update(self, y, u):
        sample, out = self.Sample(), self.Estimate()
        sample.y[:], sample.u[:] = y, u
        return self.library.car_update(self.at, ctypes.byref(sample), ctypes.byref(out)), out


def equal(a, b):
    return np.array_equal(np.array(a), np.array(b), equal_nan=True)


@needs_compiler
@EACH
def test_same_as_python_to_the_last_bit_whatever_it_is_given(variant, monkeypatch):
    """Missing, late and wild outputs, inputs that are no numbers, a restart."""
    level = "-O0" if variant == "many steps" else "-O2"  # which takes the optimiser three times as long as the others
    monkeypatch.setenv("SLIPANGLE_CFLAGS", f"{level} -march=native")
    settings, rng = VARIANTS[variant], np.random.default_rng(4)
    model = settings.model
    exported = LoadedFilter(project_of(settings, "car", 3).everything)
    start = 0.1 * rng.normal(size=model.n_states)
    tracker = settings.start_at(start)
    assert exported.start(start) == 0
    x, outliers, refused = start, 0, 0
    for k in range(300):
        u = np.array([0.03 * np.sin(0.1 * k), 20.0])
        x = np.asarray(model.step(x, u))
        y = np.asarray(model.output(x, u)) + 0.02 * rng.normal(size=model.n_outputs)
        y[rng.uniform(size=len(y)) < 0.2] = np.nan
        if k % 17 == 3:
            y[rng.integers(len(y))] = rng.choice([50.0, np.inf, -1e4])
        given = np.array([u[0], np.nan]) if k % 41 == 7 else u
        if k == 200:
            tracker.restart(start)
            assert exported.start(start, again=True) == 0
        code, out = exported.update(y, given)
        try:
            tracker.update(y, given)
        except NotFiniteError:
            assert code == 2
            refused += 1
        else:
            assert code == 0
            assert equal(out.innovation, tracker.innovation[0])
            assert equal(out.innovation_std, tracker.innovation[1])
            assert equal(np.array(out.taken, dtype=bool), tracker.taken)
            outliers += int((np.isfinite(tracker.innovation[0]) & ~tracker.taken).sum())
        assert equal(out.state, tracker.state), k
        assert equal(out.state_std, tracker.state_std), k
        assert equal(out.bias, tracker.biases)
        assert equal(out.bias_std, tracker.biases_std)
        assert np.array(out.parameter) == pytest.approx(tracker.parameters, rel=1e-14)
        assert np.array(out.parameter_std) == pytest.approx(tracker.parameters_std, rel=1e-14)
    assert refused > 5
    assert outliers > 5 or settings.gate is None
    assert exported.start([np.nan] * model.n_states) == 2


@needs_compiler
@pytest.mark.parametrize("variant", ["observer", "late, gate, offsets"])
def test_what_diverges_is_as_before(variant, monkeypatch):
    """Measurements beyond the largest number leave no trace, here and in C: as if they had never come."""
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O2 -march=native")
    settings = VARIANTS[variant]
    wild = sa.EKF(**{f: getattr(settings, f) for f in settings.__dataclass_fields__} | {"gate": None})
    exported, tracker, codes = LoadedFilter(project_of(wild, "car", 3).everything), wild.start_at(), []
    spared = wild.start_at()
    exported.start(np.zeros(wild.model.n_states))
    rng = np.random.default_rng(2)
    for k in range(60):
        y, u = 0.1 * rng.normal(size=wild.model.n_outputs), np.array([0.01, 20.0])
        if k % 9 == 5:
            y[:] = 1.7e308 * rng.choice([-1, 1], size=len(y))
        code, out = exported.update(y, u)
        codes.append(code)
        try:
            tracker.update(y, u)
        except SimulationError:
            assert code == 3
        if code == 0:
            spared.update(y, u)
        assert np.isfinite(out.state).all()
        assert equal(tracker.state, spared.state)
        assert equal(out.state, tracker.state), k
        assert equal(out.state_std, tracker.state_std), k
    assert {0, 3} == set(codes)


@pytest.mark.parametrize(
    "variant", [pytest.param(v, marks=[pytest.mark.slow] * (v in ("observer", "one state"))) for v in VARIANTS]
)
@pytest.mark.parametrize("compiler_", ["gcc", "clang"])
def test_compilers_have_nothing_to_say(variant, compiler_, tmp_path):
    needs(compiler_)
    for file, content in project_of(VARIANTS[variant], "racer", 3).everything.items():
        (tmp_path / file).write_text(content)
    for file in ("racer.c", "main.c"):
        run(compiler_, *STRICT, "-O1", "-fsyntax-only", file, folder=tmp_path)
    (tmp_path / "use.cpp").write_text('#include "racer.hpp"\nint main() { racer::Estimator e; return e.update({}); }')
    if compiler_ == "gcc":
        needs("g++")
        run("g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "use.cpp", folder=tmp_path)


def test_a_record_is_replayed(tmp_path):
    needs("make", "gcc")
    t = 0.02 * np.arange(200)
    u = np.column_stack([0.02 * np.sin(2 * t), np.full(len(t), 20.0)])
    x, y = np.zeros(2), []
    for now in u:
        y.append(np.asarray(CAR.output(x, now)))
        x = np.asarray(CAR.step(x, now))
    data = sa.Dataset.from_arrays(
        dict(zip(CAR.inputs, u.T, strict=True)), dict(zip(CAR.outputs, np.array(y).T, strict=True)), 0.02
    )
    folder = VARIANTS["parameters"].export(tmp_path / "made", name="racer", drive=data)
    assert "200 samples" in run("make", "-s", "replay", "CC=gcc", folder=folder)
    with pytest.raises(ParameterError, match="expected a Dataset"):
        project_of(VARIANTS["observer"], "car", Drive(columns=(), asked=t, commands=t, controls=()))


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_two_thousand_samples_on_every_machine(name, tmp_path):
    """The same states to 1e-10 from every compiler and processor."""
    for file, content in project_of(VARIANTS["late, gate, offsets"], "car", 2000).everything.items():
        (tmp_path / file).write_text(content)
    said = built_and_run(name, ["car.c", "main.c"], tmp_path, "--states", stdin=tmp_path / "drive.csv")
    rows = np.array([line.split(",") for line in said.split()], dtype=float)
    wanted = np.loadtxt(tmp_path / "drive.csv", delimiter=",", skiprows=1)[:, -rows.shape[1] :]
    assert len(rows) == 2000
    assert np.abs(wanted[:, :2]).max() > 0.1
    assert (np.abs(rows - wanted) / (1 + np.abs(wanted))).max() <= 1e-10
