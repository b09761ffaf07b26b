"""A whole report from synthetic data: every kind of block and figure, with awkward names."""

from __future__ import annotations

import numpy as np

from slipangle.data.dataset import Channel
from slipangle.models.model import FitInfo
from slipangle.report import (
    Body,
    Fact,
    Figure,
    Finding,
    Findings,
    Grid,
    Number,
    Page,
    Record,
    ScoreRow,
    Section,
    Signal,
    Span,
    Text,
    Verdict,
    correlation,
    correlogram,
    forest,
    measured_vs_simulated,
    parameter_table,
    path_map,
    rainclouds,
    record_table,
    score_table,
    signals,
    solver_histogram,
    solver_time,
    track_map,
)

YAW_RATE = Channel("r", "rad/s")
COMMAND = "slipangle run examples/ferrari_250lm.toml --json"
NASTY = 'ARX(4, 9) <script>alert("x")</script> & co'


def fit_info(*, weak: bool = True) -> FitInfo:
    """Six parameters of a bicycle, the last of them hardly determined."""
    names = ("C_f", "C_r", "inertia_z", "steering_gain", "steering_offset", "l_f")
    values = np.array([81234.5, 102345.6, 1480.2, 1.043, -0.0021, 1.21])
    share = np.array([0.02, 0.05, 0.31, 0.012, 0.2, 2.4 if weak else 0.04])
    return FitInfo(
        names=names,
        values=values,
        covariance=np.diag((share * values) ** 2),
        noise_std=np.array([0.02]),
        n_samples=7700,
        units=("N/rad", "N/rad", "kg m2", "-", "rad", "m"),
        seconds=3.2,
        method="simulation error, trust-region least squares; covariance with correlated residuals",
        warnings=("The data do not determine l_f: its 95 % interval is wider than its value.",) if weak else (),
    )


def lap(n: int, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time, position and yaw rate of a closed course."""
    t = dt * np.arange(n)
    phase = 2 * np.pi * t / 90
    X = 420 * np.cos(phase) + 70 * np.cos(3 * phase) + 20 * np.sin(5 * phase)
    Y = 260 * np.sin(phase) + 55 * np.sin(2 * phase) - 25 * np.cos(4 * phase)
    psi = np.unwrap(np.arctan2(np.gradient(Y), np.gradient(X)))
    return t, X, Y, np.gradient(psi, dt)


def validation_sections(n: int = 3300) -> tuple[Section, ...]:
    """What is known of the models."""
    rng = np.random.default_rng(1)
    t, X, Y, r = lap(n, 0.05)
    slow = np.convolve(rng.standard_normal(n), np.ones(15) / 15, mode="same")
    measured = r + 0.01 * rng.standard_normal(n)
    models = {
        "bicycle": 0.86 * r + 0.05 * slow,
        NASTY: r + 0.03 * slow + 0.01 * rng.standard_t(3, n),
        "bicycle with Magic Formula tires": r + 0.02 * slow,
    }
    for values in models.values():
        values[:9] = np.nan
    errors = {name: measured - y for name, y in models.items()}
    lags = np.arange(41)
    rho = 0.8**lags + 0.02 * rng.standard_normal(41)
    rho[0] = 1.0
    both = np.arange(-40, 41)
    cross = 0.12 * np.exp(-((both - 3) ** 2) / 8) + 0.02 * rng.standard_normal(81)
    band = 2.576 / np.sqrt(n)
    shown = Section(
        title="Measured and simulated",
        short="Simulation",
        lead="One free run over the whole test part: after the first samples no model sees a measured yaw rate again.",
        blocks=(
            Figure(
                title="Yaw rate over time",
                figure=measured_vs_simulated(t, measured, models, channel=YAW_RATE, starts=(0, n // 2)),
                caption="Drag to zoom, double-click to return. Below: measured minus simulated.",
                command=COMMAND,
            ),
            Figure(
                title="Error of each model",
                figure=rainclouds(errors, channel=YAW_RATE),
                caption="Density, quartile box with whiskers to 1.5 interquartile ranges, and a draw of 300 samples.",
            ),
            Grid(
                figures=tuple(
                    Figure(
                        title=f"Correlation: {name}",
                        figure=correlation(measured, y, channel=YAW_RATE, index=k),
                        caption="Dashed: where simulated equals measured.",
                    )
                    for k, (name, y) in enumerate(models.items())
                )
            ),
            Figure(
                title="Where on the track the bicycle errs",
                figure=track_map(X, Y, errors["bicycle"], channel=YAW_RATE),
            ),
            score_table(
                [
                    ScoreRow(
                        model=name,
                        channel="r",
                        unit="rad/s",
                        kind=kind,
                        fit=fit,
                        vaf=vaf,
                        r2=vaf / 100,
                        rmse=rmse,
                        tone=tone,
                        command=command,
                    )
                    for name, kind, fit, vaf, rmse, tone, command in (
                        ("bicycle", "free run", 79.1342, 95.701, 0.04123, "fair", COMMAND),
                        ("bicycle", "one-step-ahead", 79.1342, 95.701, 0.04123, None, ""),
                        (NASTY, "free run", 93.2, 99.55, 0.0137, "good", ""),
                        (NASTY, "one-step-ahead", 99.912, 99.9998, 0.00121, None, ""),
                    )
                ],
                caption="A model of physics alone takes nothing from the last measurement, so both rows agree.",
            ),
        ),
    )
    residuals = Section(
        title="Residual tests",
        short="Residuals",
        blocks=(
            Grid(
                figures=(
                    Figure(
                        title="Autocorrelation, bicycle",
                        figure=correlogram(
                            lags, rho, band=band, label="autocorrelation of the one-step residual", dt=0.05
                        ),
                    ),
                    Figure(
                        title="Against the steering angle, bicycle",
                        figure=correlogram(both, cross, band=band, label="correlation of residual and delta"),
                    ),
                )
            ),
            Text(text="The residuals are not white: dynamics are left in them.\n\nA second paragraph."),
        ),
    )
    return shown, residuals


def parameter_section() -> Section:
    """Parameters with intervals."""
    return Section(
        title="Parameters",
        blocks=(
            Figure(
                title="95 % confidence intervals",
                figure=forest(fit_info(), references={"C_f": 80000.0, "inertia_z": 1850.0, "not_there": 1.0}),
            ),
            parameter_table(fit_info(), references={"C_f": 80000.0, "inertia_z": 1850.0}, reference_title="true"),
        ),
    )


def data_section() -> Section:
    """The log and what is odd in it."""
    t, _, _, r = lap(9000, 0.05)
    delta = 0.05 * r + 0.01
    return Section(
        title="The log",
        short="Data",
        blocks=(
            Figure(
                title="Recorded channels",
                figure=signals(
                    t,
                    [
                        Signal(channel=Channel("delta", "rad"), values=delta),
                        Signal(channel=Channel("v_x", "m/s"), values=30 - 20 * np.abs(r)),
                        Signal(channel=YAW_RATE, values=r),
                    ],
                    spans=(
                        Span(start=0, end=0.7 * t[-1], label="training"),
                        Span(start=0.7 * t[-1], end=t[-1], label="test"),
                    ),
                ),
            ),
            Findings(
                title="What was seen in the data",
                items=(
                    Finding(
                        sentence="The steering angle has four single-sample spikes, the first at 207.26 s; a median "
                        "over five samples removes them.",
                        tone="fair",
                    ),
                    Finding(sentence="The yaw rate follows the steering angle by 80 ms.", tone="poor"),
                    Finding(sentence="There are no gaps.", tone="good"),
                    Finding(sentence="Steering on straights reads -0.0021 rad."),
                ),
            ),
        ),
    )


def controller_section() -> Section:
    """A lane change under control."""
    rng = np.random.default_rng(2)
    t = 0.05 * np.arange(120)
    X = 20.0 * t
    Y = 3.5 * (1 / (1 + np.exp(-(X - 32) / 4)) - 1 / (1 + np.exp(-(X - 78) / 4)))
    psi = np.arctan(np.gradient(Y, X))
    lane = np.array(
        [[0, 1.2], [15, 1.2], [np.nan, np.nan], [45, 5.0], [70, 5.0], [np.nan, np.nan], [95, 1.6], [125, 1.6]]
    )
    seconds = 0.003 * np.exp(0.4 * rng.standard_normal(120))
    seconds[40] = 0.061
    failed = np.zeros(120, dtype=bool)
    failed[40] = True
    return Section(
        title="Closed loop: ISO 3888-1 lane change",
        short="Closed loop",
        blocks=(
            Figure(
                title="Path",
                figure=path_map(
                    X,
                    Y,
                    psi,
                    reference=np.column_stack([X, np.roll(Y, -2)])[:-2],
                    left=lane,
                    right=lane - [0.0, 2.7],
                    body=Body(),
                ),
            ),
            Figure(
                title="Input, lateral error and speed",
                figure=signals(
                    t,
                    [
                        Signal(
                            channel=Channel("delta", "rad"),
                            values=np.clip(0.4 * np.gradient(psi, t), -0.1, 0.1),
                            lower=-0.1,
                            upper=0.1,
                            held=True,
                        ),
                        Signal(channel=Channel("e_y", "m"), values=0.1 * np.sin(t)),
                        Signal(
                            channel=Channel("v_x", "m/s"), values=20 + 0.1 * np.sin(t), reference=np.full(120, 20.0)
                        ),
                    ],
                ),
            ),
            Grid(
                figures=(
                    Figure(title="Solver time per step", figure=solver_time(seconds, deadline=0.05, failed=failed)),
                    Figure(title="Distribution of solver time", figure=solver_histogram(seconds, deadline=0.05)),
                )
            ),
        ),
    )


def example_page() -> Page:
    """The whole page."""
    verdicts = (
        Verdict(
            title="Simulation",
            sentence="The bicycle explains 95.7 % of the yaw rate's variance over 165 s it has never seen, in one free "
            "run; it misses the sharpest corners.",
            tone="fair",
            numbers=(
                Number(label="fit of the yaw rate", value=79.1342, unit="%", reference=72.87),
                Number(label="VAF of the yaw rate", value=95.701, unit="%", reference=93.21),
                Number(label="RMSE of the yaw rate", value=0.04123, unit="rad/s", reference=0.054, digits=3),
                Number(label="worst error", value=0.312, unit="rad/s", note="at t = 623.4 s, hairpin"),
            ),
            command=COMMAND,
        ),
        Verdict(
            title="Parameters",
            sentence="The yaw inertia is not to be trusted: it trades against the delay between steering and yaw rate.",
            tone="poor",
        ),
        Verdict(
            title="Controller",
            sentence="The controller tracks the lane change within 12 cm, and every step but one meets its deadline.",
            tone="good",
            numbers=(Number(label="largest lateral error", value=0.1187, unit="m"),),
        ),
    )
    records = record_table(
        [
            Record(
                row="table 8.2, M1",
                quantity="fit of r [%]",
                thesis=72.87,
                here=79.13,
                bound=">= 79",
                holds=True,
                note="one free run over 165 s; the thesis' test part is shorter",
            ),
            Record(
                row="table 8.2, M1", quantity="VAF of r [%]", thesis=None, here=float("nan"), bound="> 95", holds=False
            ),
        ],
        command="slipangle reproduce table-8.2",
    )
    return Page(
        title="Ferrari 250 LM: from log to controller",
        subtitle="Targa Sixty-Six, 20 Hz, 550 s; models fitted to the first 70 %, judged on the rest.",
        sections=(
            Section(title="Verdict", blocks=verdicts),
            *validation_sections(),
            parameter_section(),
            data_section(),
            controller_section(),
            Section(title="Beside the thesis", blocks=(records,)),
        ),
        facts=(Fact(label="slipangle", value="0.1.0"), Fact(label="data", value="sha256 0123456789abcdef")),
        command="slipangle run examples/ferrari_250lm.toml",
    )
