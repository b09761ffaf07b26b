"""Rates that solve equations: against SciPy, CasADi's IDAS and the same models written out; fits and plans of them."""

import pickle

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from slipangle.codegen.expression import scalar_code
from slipangle.codegen.inline import inlined
from slipangle.control.mpc import MPC
from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.custom import Ode
from slipangle.models.storage import load, save
from slipangle.ops import sqrt, tanh
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime.program import source
from slipangle.optimal.scenarios import Scenarios
from slipangle.optimal.terms import Limits, Weights

CAR = {"m": (1500.0, 1000.0, 2000.0), "I": (2500.0, 1000.0, 5000.0), "mu": (0.9, 0.3, 1.5)}
V = 20.0


def force(load, slip, p):
    """Lateral force of a front axle whose grip falls with its load."""
    return p.mu * load * (1 - 1e-5 * load) * tanh(8.0 * slip)


def slip(x, u):
    return u[0] - (x[0] + 1.2 * x[1]) / V


def rates(x, z, u, p):
    rear = 4e4 * (1.3 * x[1] - x[0]) / V
    return [(z[0] + rear) / p.m - V * x[1], (1.2 * z[0] - 1.3 * rear) / p.I]


def load_transfer(**settings):
    """A bicycle whose front load leans with the force that it makes: an algebraic loop."""
    given = {
        "f": rates,
        "algebraic": lambda x, z, u, p: [z[0] - force(0.5 * 9.81 * p.m + 0.4 * z[0], slip(x, u), p)],
        "guess": {"F_yf": 0.0},
        "states": ("v_y", "r"),
        "inputs": ("delta",),
        "outputs": ("r", "F_yf"),
        "params": CAR,
        "dt": 0.02,
    }
    return Ode(**(given | settings))


def solved_force(x, u, m=1500.0, mu=0.9):
    """The same force by bisection."""

    class P:
        pass

    P.mu = mu
    return brentq(lambda z: z - force(0.5 * 9.81 * m + 0.4 * z, slip(x, u), P), -3e4, 3e4, xtol=1e-12, rtol=1e-15)


def test_a_loop_of_loads_is_solved_as_by_bisection():
    model, rng = load_transfer(), np.random.default_rng(0)
    for _ in range(20):
        x, u = rng.normal(size=2) * (0.5, 0.3), rng.normal(size=1) * 0.05
        assert model.output(x, u)[1] == pytest.approx(solved_force(x, u), rel=1e-10, abs=1e-8)


@pytest.mark.parametrize("method", ["rk4", "radau"])
def test_a_free_run_is_that_of_scipy(method):
    model = load_transfer(method=method, substeps=0 if method == "radau" else 4)
    p = model.params

    def derivative(t, x):
        u = np.array([0.03])
        return np.asarray(rates(x, [solved_force(x, u)], u, p))

    theirs = solve_ivp(derivative, (0, 0.4), [0.0, 0.0], "DOP853", rtol=1e-12, atol=1e-12)
    x = np.zeros(2)
    for _ in range(20):
        x = np.asarray(model.step(x, np.array([0.03]))).ravel()
    assert x == pytest.approx(theirs.y[:, -1], abs=1e-8)


def cartesian(**settings):
    """A pendulum by position and velocity of its mass; its rod pulls with a force that keeps its length, by two
    derivatives of that length."""
    given = {
        "f": lambda x, z, u, p: [x[2], x[3], -z[0] * x[0] / p.m + u[0], -z[0] * x[1] / p.m - 9.81],
        "algebraic": lambda x, z, u, p: [
            x[2] * x[2] + x[3] * x[3] + x[0] * (-z[0] * x[0] / p.m + u[0]) + x[1] * (-z[0] * x[1] / p.m - 9.81)
        ],
        "guess": {"pull": 1.0},
        "states": ("x", "y", "v_x", "v_y"),
        "inputs": ("wind",),
        "outputs": ("x", "y", "pull"),
        "params": {"m": (1.0, 0.5, 2.0)},
        "dt": 0.02,
        "substeps": 8,
    }
    return Ode(**(given | settings))


def test_a_pendulum_in_cartesian_coordinates_is_that_of_its_angle():
    model, x, angle = cartesian(), np.array([np.sin(1.0), -np.cos(1.0), 0.0, 0.0]), np.array([1.0, 0.0])
    for wind in np.linspace(0.0, 3.0, 50):
        x = np.asarray(model.step(x, np.array([wind]))).ravel()
        swung = solve_ivp(
            lambda t, a, w=wind: [a[1], -9.81 * np.sin(a[0]) + w * np.cos(a[0])],
            (0, 0.02),
            angle,
            rtol=1e-12,
            atol=1e-12,
        )
        angle = swung.y[:, -1]
    assert x[:2] == pytest.approx([np.sin(angle[0]), -np.cos(angle[0])], abs=1e-7)
    pull = angle[1] ** 2 + 9.81 * np.cos(angle[0]) + 3.0 * np.sin(angle[0])
    assert model.output(x, np.array([3.0]))[2] == pytest.approx(pull, abs=1e-6)


def test_a_pendulum_is_that_of_idas():
    model, x, z, u = cartesian(), ca.SX.sym("x", 4), ca.SX.sym("z"), ca.SX.sym("u")
    dae = {"x": x, "z": z, "p": u, "ode": ca.vertcat(*model.f(x, z, [u], model.params))}
    dae["alg"] = ca.vertcat(*model.algebraic(x, z, [u], model.params))
    idas = ca.integrator("idas", "idas", dae, 0.0, 0.5, {"abstol": 1e-12, "reltol": 1e-12})
    start = np.array([0.6, -0.8, 0.4, 0.3])
    theirs = idas(x0=start, z0=1.0, p=0.7)
    ours = start
    for _ in range(25):
        ours = np.asarray(model.step(ours, np.array([0.7]))).ravel()
    assert ours == pytest.approx(np.asarray(theirs["xf"]).ravel(), abs=1e-7)
    assert model.output(ours, np.array([0.7]))[2] == pytest.approx(float(theirs["zf"]), abs=1e-6)


def stiffening(**settings):
    """Two rates of which one is under a cube and both are coupled, and a tire that relaxes."""
    given = {
        "implicit": lambda x_dot, x, u, p: [
            x_dot[0] + p.cube * x_dot[0] ** 3 + 0.2 * x_dot[1] + x[0] - u[0],
            0.1 * x_dot[1] + 0.05 * x_dot[0] + x[1] - tanh(x[0]),
        ],
        "states": ("a", "b"),
        "inputs": ("u",),
        "params": {"cube": (0.5, 0.0, 5.0)},
        "dt": 0.05,
    }
    return Ode(**(given | settings))


def test_implicit_rates_are_those_of_idas():
    model, x, d, u = stiffening(substeps=20), ca.SX.sym("x", 2), ca.SX.sym("d", 2), ca.SX.sym("u")
    alg = ca.vertcat(*model.implicit(d, x, [u], model.params))
    idas = ca.integrator(
        "idas", "idas", {"x": x, "z": d, "p": u, "ode": d, "alg": alg}, 0.0, 1.0, {"abstol": 1e-12, "reltol": 1e-12}
    )
    theirs, ours = np.asarray(idas(x0=[0.5, -0.2], z0=0, p=1.5)["xf"]).ravel(), np.array([0.5, -0.2])
    for _ in range(20):
        ours = np.asarray(model.step(ours, np.array([1.5]))).ravel()
    assert ours == pytest.approx(theirs, abs=1e-8)


def test_equations_in_straight_lines_are_solved_at_once():
    """A mass matrix: the same as rates written out, with no Newton step in the code."""
    coupled = Ode(
        implicit=lambda d, x, u, p: [p.m * d[0] + 0.3 * d[1] - u[0] + x[0], 0.3 * d[0] + d[1] - x[0] * x[1]],
        states=("a", "b"),
        inputs=("u",),
        params={"m": 2.0},
        dt=0.1,
    )
    x, u = np.array([0.4, 0.3]), np.array([1.0])
    assert coupled.derivative(x, u) == pytest.approx(np.linalg.solve([[2.0, 0.3], [0.3, 1.0]], [0.6, 0.12]), abs=1e-14)
    step = coupled.functions[0]
    assert ca.OP_CALL not in [step.instruction_id(k) for k in range(step.n_instructions())]


@pytest.mark.parametrize("newton", [8, 12])
def test_derivatives_are_those_of_the_implicit_function_theorem(newton):
    """First and second ones, against CasADi's rootfinder; in line too."""
    model = stiffening(newton=newton)
    x, u, y = ca.SX.sym("x", 2), ca.SX.sym("u", 1), ca.SX.sym("y", 2)
    rate, at = model.derivative(x, u), ca.vertcat(x, u)
    ours = ca.Function("ours", [at], [rate, ca.jacobian(rate, at), ca.hessian(rate[0], at)[0]])
    equations = ca.vertcat(*model.implicit(y, x, u, model.params))
    root = ca.rootfinder("root", "newton", {"x": y, "p": at, "g": equations}, {"abstol": 1e-14})
    m = ca.MX.sym("m", 3)
    found = root(ca.DM.zeros(2), m)
    theirs = ca.Function("theirs", [m], [found, ca.jacobian(found, m), ca.hessian(found[0], m)[0]])
    for point in np.random.default_rng(1).normal(size=(10, 3)):
        for function in (ours, inlined(ours)):
            for a, b in zip(function(point), theirs(point), strict=True):
                assert np.asarray(a) == pytest.approx(np.asarray(b), rel=1e-9, abs=1e-11)


def test_a_batch_goes_through_the_same_equations():
    model, rng = load_transfer(), np.random.default_rng(2)
    x, u = rng.normal(size=(2, 7)) * 0.3, rng.normal(size=(1, 7)) * 0.03
    together = model.derivative(x, u)
    for i in range(7):
        assert together[:, i] == pytest.approx(model.derivative(x[:, i], u[:, i]), rel=1e-14)


def test_rates_that_no_value_gives_are_no_numbers():
    """A root of a negative number: NaN where there is no solution, whatever Newton's method ended with."""
    model = Ode(
        f=lambda x, z, u, p: [z[0]],
        algebraic=lambda x, z, u, p: [z[0] * z[0] - u[0]],
        guess={"root": lambda x, u, p: 1.0 + 0.0 * u[0]},
        states=("a",),
        inputs=("u",),
        outputs=("root",),
        params={},
        dt=0.01,
    )
    assert model.output([0.0], [4.0])[0] == pytest.approx(2.0, rel=1e-15)
    assert np.isnan(model.output([0.0], [-4.0])[0])
    mpc = MPC(model, horizon=5, controls=("u",), Q=Weights(a=1.0), R=Weights(u=0.1), limits=Limits(u=(-9.0, -1.0)))
    assert not mpc.plan(np.zeros(1), a=1.0).status.solved


def test_the_code_of_plans_is_that_of_columns():
    """Nothing leaves the fast path: the functions become scalar instructions of vectors."""
    for model in (load_transfer(), stiffening(substeps=1), cartesian(substeps=1), stiffening(method="radau")):
        mpc = MPC(model, horizon=4, controls=model.inputs, Q=Weights({model.states[0]: 1.0}), R={model.inputs[0]: 1.0})
        text = source(mpc.ocp)
        assert f"#define DYNAMICS {'RADAU' if model.method == 'radau' else 'EXPLICIT'}" in text
        assert "#define STAGE EXPLICIT" in text
        assert model.method == "radau" or scalar_code(model.functions[0]) is not None


@pytest.mark.parametrize("kind", [load_transfer, cartesian, stiffening])
def test_copies_and_files_keep_the_equations(kind, tmp_path):
    model = kind()
    rng = np.random.default_rng(4)
    save(model.recorded(), tmp_path / "model.json")
    for other in (pickle.loads(pickle.dumps(model)), model.recorded(), load(tmp_path / "model.json")):
        x, u = 0.1 * rng.normal(size=model.n_states), 0.1 * rng.normal(size=1)
        assert other.step(x, u) == pytest.approx(model.step(x, u), rel=1e-14)
        assert other.output(x, u) == pytest.approx(model.output(x, u), rel=1e-13)


def recorded_run(model, n=400):
    rng = np.random.default_rng(5)
    u = 0.04 * np.sin(np.arange(n) * 0.05)[:, None] + 0.01 * rng.normal(size=(n, 1))
    x, rows = np.zeros(model.n_states), []
    for k in range(n):
        rows.append(np.asarray(model.output(x, u[k])).ravel())
        x = np.asarray(model.step(x, u[k])).ravel()
    channels = {name: np.array(rows)[:, i] for i, name in enumerate(model.outputs)}
    return Dataset.from_arrays({model.inputs[0]: u[:, 0]}, channels, model.dt)


def test_parameters_of_solved_equations_are_found():
    true = load_transfer().with_values(mu=0.75, I=2200.0)
    data, start = recorded_run(true), load_transfer(outputs=("r",))
    assert data.columns(("r",)) == pytest.approx(true.simulate(data).y[:, :1], rel=1e-12, abs=1e-14)
    fitted = GreyBox(start=start, free=("mu", "I")).fit(data)
    assert fitted.value("mu") == pytest.approx(0.75, rel=1e-6)
    assert fitted.value("I") == pytest.approx(2200.0, rel=1e-6)


def plain(x0, wanted, bound, n, model):
    """The plan of the stiffening model by Ipopt, with the rates of every Runge-Kutta stage as variables."""
    u, cost, g, variables, x = ca.SX.sym("u", n), 0, [], [], ca.SX(x0)
    h = model.dt / model.substeps

    def rate(x, u):
        y = ca.SX.sym("y", 2)
        variables.append(y)
        g.append(ca.vertcat(*model.implicit(y, x, [u], model.params)))
        return y

    for k in range(n):
        cost += 2.0 * (x[0] - wanted) ** 2 + 0.1 * x[1] ** 2 + 0.05 * u[k] ** 2
        for _ in range(model.substeps):
            k1 = rate(x, u[k])
            k2 = rate(x + h / 2 * k1, u[k])
            k3 = rate(x + h / 2 * k2, u[k])
            k4 = rate(x + h * k3, u[k])
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    cost += 2.0 * (x[0] - wanted) ** 2 + 0.1 * x[1] ** 2
    v = ca.vertcat(u, *variables)
    options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-13, "bound_relax_factor": 0.0}}
    limit = np.append(np.full(n, bound), np.full(v.numel() - n, np.inf))
    solve = ca.nlpsol("plain", "ipopt", {"x": v, "f": cost, "g": ca.vertcat(*g)}, options)
    found = solve(x0=0.0, lbx=-limit, ubx=limit, lbg=0.0, ubg=0.0)
    return float(found["f"]), np.asarray(found["x"]).ravel()[:n]


@pytest.mark.parametrize(
    "solver", [pytest.param("condensed", marks=pytest.mark.slow), "riccati", "interpreted", "ipopt"], indirect=True
)
def test_plans_are_those_of_a_plain_program(solver):
    mpc = MPC(
        stiffening(substeps=2),
        horizon=6,
        controls=("u",),
        Q=Weights(a=2.0, b=0.1),
        R=Weights(u=0.05),
        limits=Limits(u=1.5),
        solver=solver,
    )
    rng = np.random.default_rng(6)
    for _ in range(4):
        x, wanted = rng.normal(size=2), rng.normal()
        plan = mpc.plan(x, a=wanted, b=0.0)
        cost, u = plain(x, wanted, 1.5, 6, mpc.model)
        assert plan.status.solved
        assert plan.cost == pytest.approx(cost, rel=1e-9)
        assert plan.u[:, 0] == pytest.approx(u, abs=1e-8)


@pytest.mark.parametrize(
    "solver", ["condensed", pytest.param("riccati", marks=pytest.mark.slow), "interpreted", "ipopt"], indirect=True
)
def test_limits_of_algebraic_variables_and_scenarios_of_parameters(solver):
    """A force that is solved for is kept below its limit, on dry road and on wet."""
    mpc = MPC(
        load_transfer(),
        horizon=8,
        controls=("delta",),
        Q=Weights(r=20.0),
        R=Weights(delta=1.0),
        limits=Limits(delta=0.1, F_yf=3000.0),
        slack_linear=Weights(F_yf=0.01),
        scenarios=Scenarios({"mu": (0.5, 0.9)}),
        solver=solver,
    )
    plan = mpc.plan(np.zeros(2), r=0.3)
    theirs = MPC(ocp=mpc.ocp, solver=Ipopt(tolerance=1e-12)).plan(np.zeros(2), r=0.3)
    assert plan.status.solved
    for branch, other, mu in zip(plan.branches, theirs.branches, (0.5, 0.9), strict=True):
        assert branch.u == pytest.approx(other.u, abs=1e-7)
        felt = [solved_force(x, u, mu=mu) for x, u in zip(branch.x[:-1], branch.u, strict=True)]
        assert max(felt) <= 3000.0 * (1 + 1e-6)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"f": None}, "neither of f and implicit"),
        ({"implicit": lambda d, x, z, u, p: [d[0], d[1]]}, "both of f and implicit"),
        ({"guess": {}}, "expected both"),
        ({"guess": {"F_yf": 0.0, "F_yr": 0.0}}, "algebraic gives 1 residuals; expected 2"),
        ({"algebraic": lambda x, z, u, p: [x[0] - u[0]]}, "index reduction"),
        ({"algebraic": 3.0}, r"expected a function algebraic\(x, z, u, p\)"),
        ({"newton": 0}, "newton is 0"),
        ({"f": lambda x, z, u, p: [sqrt(z[0])]}, "gives 1 rates"),
    ],
)
def test_what_makes_no_sense_is_said(settings, words):
    with pytest.raises(ParameterError, match=words):
        load_transfer(**settings)
