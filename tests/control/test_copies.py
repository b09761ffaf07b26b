"""Controllers in several threads, in copies, in other processes: the same plans, bit by bit."""

import copy
import gc
import pickle
import threading
from dataclasses import replace

import numpy as np
import pytest

from slipangle.control.followers.preview_lqr import PreviewLQR
from slipangle.control.marx.adaptation import AdaptiveMultiARXMPC
from slipangle.control.mpc import MPC
from slipangle.models.custom import Ode
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.numerics.per_thread import PerThread
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.interpreted import InterpretedEngine
from slipangle.optimal.terms import Limits, Weights
from slipangle.paths.lane_change import double_lane_change
from tests.control.marx.test_mpc import BY_POSE
from tests.models.all_models import ALL_MODELS

PATH = double_lane_change(15.0)
GROUND = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("v_y", "r")))


def steering(solver=None, model=GROUND, horizon=8, **options):
    """A car of five states, limits on its steering."""
    return MPC(
        model,
        horizon=horizon,
        Q=Weights(e_y=10.0, e_psi=1.0),
        R=Weights(delta=1.0),
        limits=Limits(delta=0.3),
        solver=RealTime() if solver is None else solver,
        **options,
    )


def interpreted(mpc):
    """The same controller as if there were no compiler."""
    vars(mpc)["_engine"] = InterpretedEngine(mpc.ocp, RealTime(), None)
    return mpc


def lagged():
    return replace(BY_POSE)


def tasks(mpc, rng, chains=6, steps=6):
    """State, reference, plan before and plan, of drives from random places, all on one controller."""
    found = []
    for _ in range(chains):
        s, plan = rng.uniform(0, 100), None
        for k in range(steps):
            reference = mpc.reference(PATH.ahead(s + 0.75 * k, mpc.times))
            X, Y, psi = reference.tracked[0, :3] if plan is None else plan.x[1, -3:]
            x = np.array(mpc.start({"v_x": 15.0, "X": X, "Y": Y, "psi": psi}))
            x[-3:] += [0.0, 0.5 * rng.standard_normal(), 0.05 * rng.standard_normal()]
            before, plan = plan, mpc.plan(x, reference, plan)
            found.append((x, reference, before, plan))
    return found


def same(a, b):
    return np.array_equal(a.u, b.u) and np.array_equal(a.x, b.x) and a.status is b.status


class Posed(MPC):
    """An `MPC` that can be asked where it starts, as the MARX controllers can."""

    def start(self, measured):
        return [measured.get(n, 0.0) for n in self.model.states]


def posed(**options):
    mpc = steering(**options)
    return Posed(**{n: getattr(mpc, n) for n in mpc.__dataclass_fields__ if n not in ("_", "identity")})


CONTROLLERS = {
    "compiled": posed,
    "limits of states": lambda: posed(corridor=1.0, **{"slack": Weights(e_y=1.0), "slack_linear": Weights(e_y=10.0)}),
    "interpreted": lambda: interpreted(posed()),
    "ipopt": lambda: posed(solver=Ipopt()),
    "marx": lagged,
    "adaptive": lambda: AdaptiveMultiARXMPC(lagged()),
}


@pytest.mark.parametrize("make", CONTROLLERS.values(), ids=CONTROLLERS)
def test_threads_give_the_plans_of_one_thread(make):
    mpc, rng = make(), np.random.default_rng(0)
    work = tasks(mpc, rng, *((2, 3) if isinstance(getattr(mpc, "solver", None), Ipopt) else (6, 6)))
    wrong, started = [], threading.Barrier(4)

    def replay(seed):
        started.wait()
        for i in np.random.default_rng(seed).permutation(np.tile(np.arange(len(work)), 3)):
            x, reference, before, plan = work[i]
            if not same(mpc.plan(x, reference, before), plan):
                wrong.append((seed, i))

    threads = [threading.Thread(target=replay, args=(seed,)) for seed in range(4)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert not wrong


def test_work_areas_are_freed_with_their_threads():
    alive = []

    class Area:
        def __init__(self):
            alive.append(self)

        def __del__(self):
            freed.append(1)

    freed = []
    areas = PerThread(Area)
    for _ in range(3):
        t = threading.Thread(target=lambda: areas.mine)
        t.start()
        t.join()
    assert len(alive) == 3
    alive.clear()
    gc.collect()
    assert len(freed) == 3


@pytest.mark.parametrize("make", [*CONTROLLERS.values(), PreviewLQR], ids=[*CONTROLLERS, "preview"])
@pytest.mark.parametrize("way", [copy.deepcopy, lambda c: pickle.loads(pickle.dumps(c))], ids=["deepcopy", "pickle"])
def test_copies_plan_the_same_before_and_after_a_plan(make, way):
    if make is PreviewLQR:
        mpc = PreviewLQR(params=SOUSA_TABLE_7_2)
        assert way(mpc) == mpc
        return
    mpc = make()
    untouched = way(make())
    if "_engine" in vars(mpc) and isinstance(vars(mpc)["_engine"], InterpretedEngine):
        untouched = interpreted(untouched)
    work = tasks(mpc, np.random.default_rng(1), 1, 3)
    for other in (way(mpc), untouched):
        if "_engine" in vars(mpc) and isinstance(vars(mpc)["_engine"], InterpretedEngine):
            interpreted(other)
        plan = None
        for x, reference, _, wanted in work:
            plan = way(other.plan(x, reference, plan))
            assert same(plan, wanted)


def test_a_copy_goes_on_from_the_plans_of_the_original():
    mpc = posed()
    *_, (x, reference, before, plan) = tasks(mpc, np.random.default_rng(2), 1, 4)
    assert same(pickle.loads(pickle.dumps(mpc)).plan(x, reference, pickle.loads(pickle.dumps(before))), plan)


def test_memory_of_another_or_a_dead_controller_is_not_taken():
    mpc = posed()
    *_, (x, reference, before, _) = tasks(mpc, np.random.default_rng(3), 1, 4)
    inputs_only = replace(before, memory=None)
    wanted = mpc.plan(x, reference, inputs_only)
    for _ in range(4):  # each takes the place of the dead one before
        other = replace(mpc, ocp=replace(mpc.ocp))
        assert other.ocp.identity != mpc.ocp.identity
        assert same(other.plan(x, reference, before), wanted)
        del other
        gc.collect()
    longer = replace(mpc, horizon=12)
    assert longer.plan(x, longer.reference(PATH.ahead(10.0, longer.times)), before).status.solved


@pytest.mark.parametrize("model", ALL_MODELS.values(), ids=ALL_MODELS)
def test_models_step_the_same_after_a_copy(model):
    x = model.straight(20.0) if hasattr(model, "straight") else np.full(model.n_states, 0.3)
    u = np.full(model.n_inputs, 0.05)
    wanted, function = model.step(x, u), model.functions[0](x, u).full()  # now it has its caches
    for other in (copy.deepcopy(model), pickle.loads(pickle.dumps(model))):
        assert np.array_equal(other.step(x, u), wanted)
        assert np.array_equal(other.functions[0](x, u).full(), function)


def test_functions_without_a_name_are_written_down():
    decay = Ode(f=lambda x, u, p: [u[0] - p.k * x[0]], states=("z",), inputs=("a",), params={"k": 2.0}, dt=0.1)
    assert pickle.loads(pickle.dumps(decay)).step([1.0], [0.5]) == decay.step([1.0], [0.5])
