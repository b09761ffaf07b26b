"""Exported path followers steer as those in Python do, on any machine."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.codegen import compiler
from slipangle.control.followers.compensated import Compensated
from slipangle.control.followers.feedforward import FeedforwardFeedback
from slipangle.control.followers.followers import PurePursuit, Stanley
from slipangle.control.followers.preview_lqr import PreviewLQR
from slipangle.errors import ParameterError
from slipangle.export.kinds import project_of
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from slipangle.paths.lane_change import double_lane_change
from tests.export.loaded import STATUSES, Loaded
from tests.export.test_mpc import upset
from tests.export.tools import MACHINES, STRICT, driven_on, needs, run

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
GEARED = FERRARI_250LM.with_values(steering_gain=0.8, steering_offset=0.01)
KINDS = {
    "pure pursuit": PurePursuit(params=GEARED, rate=1.0),
    "Stanley": Stanley(params=GEARED),
    "LQR with preview": PreviewLQR(params=GEARED, horizon=15),
    "feed-forward and feedback law": FeedforwardFeedback(params=GEARED, lead=0.07),
}
LATE = Delayed(
    Steered(Bicycle(params=GEARED, dt=0.05, outputs=("r",)), steering_lag=0.1), delays={"delta": 0.05}, longest=0.1
)
KINDS |= {
    f"{name}, compensated": Compensated(follower=replace(KINDS[name], rate=1.0), car=LATE)
    for name in ("Stanley", "LQR with preview", "feed-forward and feedback law")
}
EACH = pytest.mark.parametrize("kind", KINDS)


@needs_compiler
@EACH
def test_same_as_python_whatever_happens(kind, monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CFLAGS", "-O1")
    follower = KINDS[kind]
    exported = Loaded(project_of(follower, "car", 3).everything)
    path, rng, previous, seen = double_lane_change(20.0), np.random.default_rng(5), None, set()
    for k in range(200):
        s = rng.uniform(0.0, 90.0)
        reference = follower.check_reference(follower.reference(path.ahead(s, follower.times)))
        X, Y, psi = reference.tracked[0, :3]
        x = follower.model.straight(20.0, X=X, Y=Y, psi=psi) + rng.normal(0.0, 0.2, follower.model.n_states)
        if len(x) == 5:
            x, reference, applied = upset(x, reference, k, rng)
        else:
            x[-1] += 2 * np.pi * rng.integers(-1, 2)
            x[0] = np.nan if k % 7 == 3 else 1e9 if k % 7 == 4 else x[0]
            applied = None
        previous = follower.plan(x, reference, previous, applied=applied)
        out = exported.plan(x, reference, applied)
        assert np.array(out.u) == pytest.approx(previous.u, rel=1e-12, abs=1e-12)
        assert (STATUSES[out.status], out.age) == (previous.status, previous.age)
        assert tuple(getattr(out.health, n) for n, _ in out.health._fields_) == tuple(previous.health)
        assert np.array_equal(np.array(out.x), previous.x)
        seen.add(previous.status.name)
    assert {"SOLVED", "NOT_FINITE", "IMPLAUSIBLE"} <= seen


@EACH
@pytest.mark.parametrize("compiler_", ["gcc", "clang"])
def test_compilers_have_nothing_to_say(kind, compiler_, tmp_path):
    needs(compiler_)
    for file, content in project_of(KINDS[kind], "car", 3).everything.items():
        (tmp_path / file).write_text(content)
    for file in ("car.c", "main.c"):
        run(compiler_, *STRICT, "-fsyntax-only", file, folder=tmp_path)


def test_what_a_subclass_changes_is_not_lost_in_silence():
    class Named(PurePursuit):
        pass

    class Straight(PurePursuit):
        def law(self, x, ahead, v_x, last):
            return 0.0

    class Late(PurePursuit):
        def plan(self, x, reference, previous=None, *, applied=None):
            return super().plan(x, reference, previous)

    assert project_of(Named(params=GEARED), "car", 3).kind == "pure pursuit"
    with pytest.raises(ParameterError, match="a Straight has a law of its own, which has no C"):
        project_of(Straight(params=GEARED), "car", 3)
    with pytest.raises(ParameterError, match="a Late has a plan of its own, which has no C"):
        project_of(Late(params=GEARED), "car", 3)


@pytest.mark.slow
@EACH
@pytest.mark.parametrize("name", MACHINES)
def test_two_thousand_steps_on_every_machine(name, kind, tmp_path):
    commands, wanted = driven_on(name, KINDS[kind], tmp_path)
    assert np.abs(commands - wanted).max() <= 1e-10
