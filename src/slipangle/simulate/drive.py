"""`drive`: a plant and a driver, which sees nothing of the plant but its measurements."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from slipangle.control.commands import AnyDriver, Commands
from slipangle.errors import ParameterError, SampleTimeError
from slipangle.optimal.solution import Plan
from slipangle.optimal.terms import Values, require_names
from slipangle.paths.path import Path
from slipangle.simulate.compiled import compiled_loop
from slipangle.simulate.plant import Plant
from slipangle.simulate.run import End, Run

FAR = 20.0  # m from the path: the drive is over


def drive(
    plant: Plant,
    driver: AnyDriver,
    *,
    duration: float | None = None,
    channels: Sequence[str] | None = None,
    held: Values | None = None,
    x0: np.ndarray | None = None,
    s0: float = 0.0,
    width: float = 1.8,
    sample: float = 0.01,
    watch: Callable[[float, Commands], None] | None = None,
) -> Run:
    """Drive a plant along the driver's path.

    The driver is called every ``sample`` with what the plant's sensors show then. Inputs of the plant are its commands,
    ``v_x`` its wanted speed, and the others those that are held. A dual track and a driver that was compiled
    (`slipangle.export.build`) are driven in compiled code from end to end, with the same numbers, unless ``watch`` or
    ``s0`` is given.

    Raises ParameterError if an input of the plant has no source, and SampleTimeError if the sample times do not divide
    each other.

    Parameters
    ----------
    plant : Plant
        Measures v_x, X, Y, psi and what else the driver's estimator uses.
    driver : AnyDriver
        Reset at the start; a `Driver`, or one that `slipangle.export.load` loaded.
    duration : float, optional
        When to stop at the latest [s]; by default at the end of an open path, after one lap of a closed one.
    channels : sequence of str, optional
        What the driver sees of the plant's measurements; by default all of them.
    held : Values, optional
        Constant inputs that the driver does not set.
    x0 : array, shape (n_states,), optional
        Where the plant starts; by default straight ahead at the path's start and speed.
    s0 : float
        Arc length near which that is, below zero before the start line of a closed path. [m]
    width, sample : float
        Vehicle width, for `Run.inside` [m]; time between calls of the driver and samples of the result [s].
    watch : callable, optional
        Called with the time [s] and the commands at every sample.
    """
    path, model, fixed = driver.path, plant.model, Values() if held is None else held
    per_sample = _checked(plant, driver, fixed, channels or (), sample)
    limit = _time_limit(path) if duration is None else duration
    X, Y, psi = path.start
    x = plant.straight(path.speed(0.0), X=X, Y=Y, psi=psi) if x0 is None else np.asarray(x0, dtype=float)
    first = {**dict.fromkeys(model.inputs, 0.0), **fixed, "v_x": path.speed(0.0)}
    simulation = plant.start(x, np.array([first[name] for name in model.inputs]))
    driver.reset()
    compiled = compiled_loop(plant, driver, channels) if watch is None and s0 == 0.0 else None
    if compiled is not None:
        ends = {"sample": sample, "limit": limit, "to_the_end": duration is None or not path.closed}
        return _run(*compiled(simulation, fixed, per_sample, **ends), plant, driver, width)
    plans: list[Plan] = []
    rows, times, near, end, tick = [], [], s0, None, 0
    while end is None:
        true, t = simulation.true(), tick * sample
        if not np.isfinite(simulation.x).all():
            end = End.NOT_FINITE
            break
        foot = path.project(true["X"], true["Y"], near)
        near, e_psi = foot.s, math.remainder(true["psi"] - foot.psi, 2 * math.pi)
        rows.append(np.concatenate([[t, foot.s, foot.e_y, e_psi, true["v_x"]], simulation.x, simulation.inputs]))
        if abs(foot.e_y) > FAR:
            end = End.LEFT_PATH
        elif (duration is None or not path.closed) and foot.s >= path.length:
            end = End.FINISHED
        elif t >= limit - 1e-9:
            end = End.TIME
        measured = simulation.measure()
        commands = driver.step(measured if channels is None else {n: measured[n] for n in channels}, t)
        if commands.plan is not None and (not plans or commands.plan is not plans[-1]):
            plans.append(commands.plan)
            times.append(t)
        if watch is not None:
            watch(t, commands)
        given = {**fixed, "v_x": commands.wanted_v_x, **commands.values}
        simulation.advance(np.array([given[name] for name in model.inputs]), per_sample)
        tick += 1
    return _run(np.array(rows), (times, plans), end, plant, driver, width)


def _checked(plant: Plant, driver: AnyDriver, held: Values, channels: Sequence[str], sample: float) -> int:
    """Steps of the plant in a sample; see `drive` for what is raised."""
    per_sample = round(sample / plant.dt)
    if per_sample < 1 or not math.isclose(per_sample * plant.dt, sample, rel_tol=1e-6):
        raise SampleTimeError(
            f"the sample time of the run is {sample:g} s, the plant's {plant.dt:g} s; expected a whole multiple"
        )
    require_names(held, plant.model.inputs, "held", "use an input of the plant")
    require_names(channels, plant.channels, "channels", "use what the plant measures")
    known = {*driver.controls, "v_x", *held}
    for name in plant.model.inputs:
        if name not in known:
            raise ParameterError(
                f"nobody sets the plant's input '{name}'; expected a source: give the driver speed=SpeedDriver(...), "
                f"or held=Values({name}=0.0)"
            )
    return per_sample


def _time_limit(path: Path) -> float:
    """Three times what the profile takes, for a vehicle that lost its speed."""
    profile = np.full_like(path.s, 0.5) if path.v_x is None else path.v_x
    return 3.0 * float(np.sum(path.spacing / np.maximum(profile[:-1], 0.5))) + 5.0


def _run(
    table: np.ndarray, planned: tuple[list[float], list[Plan]], end: End, plant: Plant, driver: AnyDriver, width: float
) -> Run:
    """The drive from its rows: t, s, e_y, e_psi, v_x, states, inputs."""
    line, n = driver.path.at(table[:, 1]), plant.model.n_states
    return Run(
        **dict(zip(("t", "s", "e_y", "e_psi", "v_x"), table.T, strict=False)),
        states=table[:, 5 : 5 + n],
        inputs=table[:, 5 + n :],
        state_names=tuple(plant.model.states),
        input_names=tuple(plant.model.inputs),
        path=driver.path,
        reference=np.column_stack([line.X, line.Y, line.psi, line.v_x]),
        t_plan=np.array(planned[0]),
        plans=tuple(replace(p, memory=None) for p in planned[1]),
        controls=planned[1][0].controls if planned[1] else driver.controls,
        end=end,
        width=width,
    )
