"""Wild calls of everything that is compiled to C: numbers that no quantity is, singular problems, memory from before.

Run as ``python -m tests.fuzz.wild <part> <calls> <seed>``, by `test_sanitizers` under a compiler with sanitizers. What
is computed is of no interest here, only that no memory is touched that is not ours and nothing undefined is done.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from slipangle.codegen import compiler as compiled
from slipangle.errors import SlipangleError
from tests.control.hostile import NEVER, ODD, poisoned


def wild(rng: np.random.Generator, array: Any) -> np.ndarray:
    """The array, sometimes with one or many entries that are no quantity, or zero, or tiny."""
    if rng.random() < 0.5:
        return np.array(array, dtype=float)
    return poisoned(array, rng, NEVER if rng.random() < 0.5 else ODD, 0.3)


def qp(calls: int, rng: np.random.Generator) -> None:
    """The quadratic program's solver."""
    from tests.optimal.realtime.qps import Solver, draw

    solver = Solver()
    for k in range(calls):
        problem = draw(rng)
        changed = tuple(wild(rng, part) if part.size and rng.random() < 0.3 else part for part in problem)
        solver(changed, warm=bool(k % 3))


def real_time(calls: int, rng: np.random.Generator) -> None:
    """The real-time solver, without and with limits on states."""
    from tests.control.test_hostile import HOSTILE

    for name in ("real time", "real time, limits of states"):
        HOSTILE[name]().run(calls, seed=int(rng.integers(1000)))


def stages(calls: int, rng: np.random.Generator) -> None:
    """The real-time solver with implicit steps of several samples, slip limits and wheels."""
    from tests.optimal.realtime.test_stages import PATH, quasi, wheels

    for make in (wheels, quasi):
        mpc, plan = make(), None
        for _ in range(calls):
            s = float(rng.uniform(0, 100))
            x = mpc.model.straight(float(rng.uniform(1, 40)), X=float(PATH.at(s).X[0]), Y=float(PATH.at(s).Y[0]))
            reference = mpc.reference(PATH.ahead(s, mpc.times), T_r=0.0)
            plan = mpc.plan(wild(rng, x), reference, plan, applied=wild(rng, np.zeros(2)))


def marx(calls: int, rng: np.random.Generator) -> None:
    """Multi-ARX control, also integral and adaptive."""
    from tests.control.test_hostile import HOSTILE

    for name in ("MARX", "MARX, integral", "adaptive"):
        HOSTILE[name]().run(calls, seed=int(rng.integers(1000)))


def free_runs(calls: int, rng: np.random.Generator) -> None:
    """Free runs of every model: ARX, NARX, neural state space, neural bicycles."""
    from tests.models.all_models import ALL_MODELS, typical

    for model in ALL_MODELS.values():
        for _ in range(max(calls // 100, 1)):
            x, u = (np.asarray(v, dtype=float) for v in typical(model, 1))
            rows = np.tile(u, (int(rng.choice([2, 3, 100, 1500])), 1))
            outputs = np.empty((len(rows) - 1, model.n_outputs))
            try:
                model.free_run(wild(rng, x), wild(rng, rows), outputs)
            except SlipangleError:
                continue


def sensitivities(calls: int, rng: np.random.Generator) -> None:
    """The free runs behind fits of physics and of Lur'e models, with derivatives."""
    from slipangle.identify.physics import forward
    from slipangle.identify.physics.free_run import FreeRun
    from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
    from slipangle.models.vehicles.single_track import SingleTrack

    car = SingleTrack(params=SOUSA_TABLE_6_1, dt=0.1, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2, method="radau")
    free = ("inertia_z", "l_f")
    run = forward.forward(car, free)
    assert run.compiled
    p = np.array([car.value(n) for n in free])
    x = np.array([20.0, 0.5, 0.1, 60.0, 60.0, 0.0, 0.0, 0.0])
    u = np.tile([0.05, 500.0, 0.0], (20, 1))
    box = FreeRun(
        lambda x, u, p: p[0] * x + p[1] * u,
        lambda x, u, p: x,
        n_states=1,
        n_parameters=2,
        records=[(np.ones((50, 1)), np.ones((50, 1)))],
        error=np.ones(1),
        free_x0=(0,),
    )
    for _ in range(calls):
        run(wild(rng, x), wild(rng, np.zeros((8, 2))), wild(rng, u), wild(rng, p))
        box.run(wild(rng, np.array([0.9, 0.1])), wild(rng, np.zeros(1)), wild(rng, np.ones((50, 1))))
        box.sensitive(wild(rng, np.array([0.9, 0.1])), wild(rng, np.zeros(1)), wild(rng, np.ones((50, 1))))


def plant(calls: int, rng: np.random.Generator) -> None:
    """The dual-track car, alone and many at once, on several threads."""
    from tests.models.vehicles.dual_track.test_dual_track import Kernel, plant

    car = plant()
    kernel = Kernel.build(car, varied=("mass", "mu_fl"))
    assert kernel is not None
    for _ in range(calls):
        cars, rows = int(rng.integers(1, 20)), int(rng.integers(1, 6))
        x = np.array([car.straight(float(v)) for v in rng.uniform(-5, 50, cars)])
        u = rng.uniform(-1, 1, size=(rows, cars, car.n_inputs + 2))
        u[..., -2], u[..., -1] = 1500.0, 0.7
        threads, hold = int(rng.integers(1, 4)), int(rng.integers(1, 20))
        kernel.run_many(wild(rng, x), wild(rng, u), hold=hold, threads=threads, last_only=bool(rng.integers(2)))
        kernel.run(wild(rng, x[0]), wild(rng, u[:, 0]), hold=3)


def recursive(calls: int, rng: np.random.Generator) -> None:
    """Recursive least squares, sample by sample and over records."""
    from slipangle.data.dataset import Dataset
    from slipangle.identify.linear.recursive import RLS

    for _ in range(max(calls // 50, 1)):
        nu, ny = int(rng.integers(1, 4)), int(rng.integers(1, 4))
        orders = {"na": int(rng.integers(1, 5)), "nb": int(rng.integers(1, 5)), "nk": int(rng.integers(0, 4))}
        forget = str(rng.choice(["directional", "everywhere"]))
        settings = RLS(**orders, offset=bool(rng.integers(2)), forgetting=0.98, forget=forget)
        names = [f"u{i}" for i in range(nu)], [f"y{i}" for i in range(ny)]
        estimate = settings.start(inputs=names[0], outputs=names[1], dt=0.1)
        for _ in range(50):
            try:
                estimate.update(wild(rng, rng.normal(size=ny)), wild(rng, rng.normal(size=nu)))
            except SlipangleError:
                pass
        for n in (1, 5, 300):
            size = float(rng.choice([1.0, 1e-300, 1e150]))
            columns = [{k: size * rng.normal(size=n) for k in group} for group in names]
            try:
                estimate.run(Dataset.from_arrays(*columns, 0.1))
            except SlipangleError:
                pass


PARTS: dict[str, Callable[[int, np.random.Generator], None]] = {
    "qp": qp,
    "real time": real_time,
    "stages": stages,
    "MARX": marx,
    "free runs": free_runs,
    "sensitivities": sensitivities,
    "plant": plant,
    "recursive": recursive,
}


def main() -> None:
    """One part, so many calls; a sentence at the end, so that nobody takes a silent crash for success."""
    part, calls, seed = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    if compiled.compiler() is None:
        raise SystemExit(compiled.sentence())
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", message=".*did not compile.*")
        PARTS[part](calls, np.random.default_rng(seed))
    print(f"clean after {calls} calls of {part}")


if __name__ == "__main__":
    main()
