"""C of a virtual sensor of lateral velocity, as learned."""

from __future__ import annotations

import numpy as np

from slipangle.codegen.expression import emit, preamble
from slipangle.data.dataset import Dataset
from slipangle.estimate.side_slip_sensor import CHANNELS, LearnedSideSlip
from slipangle.export.controllers import number, table
from slipangle.export.meanings import meaning
from slipangle.export.memory import size_of
from slipangle.export.names import comment, constants
from slipangle.export.project import Project, replay, template
from slipangle.models.vehicles.parameters import GRAVITY


def sensor_project(sensor: LearnedSideSlip, name: str, data: Dataset | int) -> Project:
    """The files of a virtual sensor.

    Parameters
    ----------
    sensor : LearnedSideSlip
        What is exported.
    name : str
        The project's name, checked.
    data : Dataset or int
        The record to be replayed, or so many samples in waves over most of what the sensor has learned in.
    """
    look, dt = sensor.look, float(sensor.dt)
    title = f"virtual sensor of lateral velocity, a sample every {dt:g} s"
    header = template("sensor.h").replace("@TITLE@", comment(title)).replace("@DT@", repr(dt))
    header = header.replace("@STD@", repr(float(sensor.std))).replace("@SLOWEST@", repr(float(look.slowest)))
    header = header.replace("@NEEDED@", str(look.first + 1))
    lines = [f"#define {c} {i} /* {meaning(n, {})} */" for i, (n, c) in enumerate(constants("CAR_C", CHANNELS).items())]
    header = header.replace("@CHANNELS@", "\n".join(lines))
    parts = [
        "#include <string.h>",
        preamble("double"),
        emit(sensor.say, "say"),
        table("LOWEST", sensor.limits[:, 0]),
        table("HIGHEST", sensor.limits[:, 1]),
        f"#define SLOWEST {number(look.slowest)}",
        f"#define LIMITED {len(sensor.limits)}",
        f"#define NEEDED {look.first + 1}",
        template("sensor.c"),
    ]
    source = "\n".join(parts)
    bytes_ = size_of(f"{header}\n{source}", "Sensor", 1)
    rows = replayed(sensor, data)
    return Project(
        name=name,
        kind="sensor",
        sentence=f"A {comment(title)}.",
        files={
            "car.h": header.replace("@BYTES@", str(bytes_)),
            "car.hpp": template("sensor.hpp"),
            "car.c": f'#include "car.h"\n{source}',
            "car_block.h": template("sensor_block.h"),
            "main.c": replay("sensor_main.c"),
        },
        drive="\n".join([",".join([*CHANNELS, "v_y"]), *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n",
        about=f"- channels: {', '.join(CHANNELS)}\n- memory: {bytes_} bytes",
        readme="SENSOR.md",
        facts={"dt": dt, "drive": {"steps": len(rows)}},
    )


def replayed(sensor: LearnedSideSlip, data: Dataset | int) -> np.ndarray:
    """Rows of the channels and the lateral velocity, NaN where nothing is said, of a sensor before its first sample."""
    if isinstance(data, Dataset):
        data.require_dt(sensor.dt, "the sensor")
        channels = data.experiments[0].columns(CHANNELS)
    else:
        t = sensor.dt * np.arange(data)
        force, _, slowness, yaw_rate, steering = sensor.span
        u, r, delta = (
            np.mean(span) + 0.4 * np.ptp(span) * np.sin(2 * np.pi * f * t)
            for span, f in ((force, 0.05), (yaw_rate, 0.07), (steering, 0.11))
        )
        v_x = np.full(data, 30.0 / np.mean(slowness))
        channels = np.column_stack([delta, v_x, r, GRAVITY * u])
    stream = sensor.begin()
    said = [stream.take(dict(zip(CHANNELS, row, strict=True))) for row in channels.tolist()]
    return np.column_stack([channels, said])
