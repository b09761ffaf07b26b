"""Second derivatives of a sample of many steps, one step after the other: those of all written out, and its plans."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.control.mpc import MPC
from slipangle.models.custom import Ode
from slipangle.models.vehicles.load_transfer import LoadTransfer
from slipangle.models.vehicles.saturating_bicycle import RelaxingBicycle, SaturatingBicycleParams
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.models.wrappers.wrapper import Wrapper
from slipangle.ops import cos, sin, stack
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.joined import Joined
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.curvature import curvature_function, curvature_sweeps
from slipangle.optimal.realtime.program import source
from slipangle.optimal.terms import Limits, Weights

EXACT = RealTime(iterations=0, tolerance=1e-11, hessian="exact", max_iterations=100)


def car(**settings):
    """As they are found: tires that relax, loads that shift, steering late and lagged, and a pose."""
    numbers = {"mass": 1000.0, "inertia_z": 800.0, "wheelbase": 2.4, "l_f": 1.3, "C_f": 6e4, "C_r": 1e5}
    grip = {"mu_f": 0.9, "mu_r": 1.0, "relaxation_f": 0.4, "relaxation_r": 0.4}
    inner = LoadTransfer(RelaxingBicycle(params=SaturatingBicycleParams(**numbers, **grip), dt=0.01), height=0.4)
    model = OnGround(Delayed(Steered(inner, steering_lag=0.05), delays={"delta": 0.014}))
    usual = {"horizon": 4, "controls": ("delta",), "Q": Weights(X=0.1, Y=1.0, psi=1.0), "S": Weights(delta=50.0)}
    return MPC(model, **(usual | {"limits": Limits(delta=0.35, r=1.0)} | settings))


def pendulum(model=None, **settings):
    """Pushed along its arm too, so that inputs and states are multiplied; twelve steps a sample."""
    arm = Ode(
        f=lambda x, u, p: [x[1], u[0] * cos(x[0]) - 4.0 * sin(x[0]) + u[1] * x[1] * x[0] - x[1] * x[1] * x[1]],
        states=("phi", "rate"),
        inputs=("a", "b"),
        params={},
        dt=0.2,
        substeps=12,
    )
    usual = {"horizon": 8, "controls": ("a", "b"), "Q": {}, "R": Weights(b=0.1)}
    usual |= {"limits": Limits(a=3.0, b=1.0, cost=(-np.inf, 0.0)), "slack_linear": Weights(cost=1.0)}
    usual["terms"] = {"cost": lambda x, u, p: (x[0] - 1.0) ** 4 + 0.2 * x[1] ** 2 + 0.1 * u[0] ** 2}
    return MPC(model or arm, **(usual | settings))


@dataclass(frozen=True, kw_only=True)
class Bent(Wrapper):
    """States and inputs that are bent on their way to the steps, and what comes out of these too."""

    model: Any

    def step(self, x, u):
        y = self.model.step(stack([x[0] + 0.2 * x[1] * x[1], x[1]]), stack([sin(u[0]) + 0.1 * x[0] * u[1], u[1]]))
        return stack([y[0] + 0.3 * u[0] * y[1], sin(y[1]) + x[0] * x[0]])

    def output(self, x, u):
        return self.model.output(x, u)

    def initial_state(self, data):
        return self.model.initial_state(data)


def bent(**settings):
    return pendulum(model=Bent(model=pendulum().model), **settings)


@pytest.mark.parametrize("mpc", [car, pendulum, bent])
def test_they_are_the_second_derivatives_of_all_steps_written_out(mpc):
    joined, rng = Joined(mpc().ocp, curved=True), np.random.default_rng(3)
    sweeps, written = curvature_sweeps(joined), curvature_function(joined)
    assert 3 * sweeps.back.n_instructions() < written.n_instructions()
    x, u, w, _, p = joined.symbols(ca.SX)
    pi, mu, nu = (ca.SX.sym("m", written.size1_in(i)) for i in (4, 5, 6))
    error, limited = joined.stage.expand()(x, u, w, p)
    lagrangian = ca.dot(pi, joined.dynamics.expand()(x, u, w)) + ca.dot(nu, error) + ca.dot(mu, limited)
    known = ca.Function("known", [x, u, w, p, pi, mu, nu], [ca.hessian(lagrangian, ca.vertcat(x, u))[0]])
    for _ in range(3):
        at = [rng.normal(size=known.size1_in(i)) * (0.2 if i < 2 else 1.0) for i in range(7)]
        if "v_x" in joined.exogenous:
            at[2][joined.exogenous.index("v_x")] = 20.0
        by_steps, at_once, truth = (np.asarray(f(*at)) for f in (sweeps.whole(), written, known))
        assert abs(truth).max() > 0.1
        assert at_once == pytest.approx(truth, abs=1e-11 * abs(truth).max())
        assert by_steps == pytest.approx(truth, abs=1e-11 * abs(truth).max())
        assert (by_steps == by_steps.T).all()


def test_steps_that_are_few_or_linear_are_written_out():
    flat = Ode(f=lambda x, u, p: [x[1], u[0]], states=("s", "v"), inputs=("a",), params={}, dt=0.2, substeps=12)
    linear = MPC(flat, horizon=4, controls=("a",), Q=Weights(s=1.0), limits=Limits(a=1.0))
    assert "curvature_back" not in source(Joined(linear.ocp, curved=True))
    assert "curvature_back" in source(Joined(car().ocp, curved=True))
    assert curvature_sweeps(Joined(pendulum(horizon=2).ocp, curved=True)).times == 12


@pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())
@pytest.mark.parametrize(
    "settings", [pytest.param({}, marks=pytest.mark.slow), {"duration": (0.8, 2.4), "terminal": Weights(duration=0.3)}]
)
def test_plans_are_those_of_ipopt(settings):
    ours, theirs = (pendulum(solver=s, **settings) for s in (EXACT, Ipopt(tolerance=1e-12)))
    for x in ([0.3, 0.0], [-0.6, 0.5]):
        plan, other = (mpc.plan(np.array(x)) for mpc in (ours, theirs))
        assert plan.status.solved
        assert plan.cost == pytest.approx(other.cost, rel=1e-9)
        assert plan.u == pytest.approx(other.u, abs=1e-6)
