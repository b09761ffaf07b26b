"""Table 6.8: the simple Magic Formula fitted to tire data, recovered on a labelled stand-in.

The thesis' rig data (Calspan, Formula SAE Tire Test Consortium) are for members only. The stand-in is made from the
coefficients that table 6.8 prints: friction over 322 slip ratios of +-0.21 and over 1268 slip angles of +-13 degrees
(B per radian), with Gaussian noise of 0.124 and 0.063, which are the residuals of the thesis' best networks. Noise
seed 0 for the table, 1 to 40 for the rates. The fit has the bounds of table 6.7 and 16 random starts, seed 0. B and C
are printed negative for mu_y: turning both signs gives the same curve, ours are positive.

B, C and E trade off against each other along a bent valley, so the intervals come from the profile likelihood. Those
shown hold jointly for all twelve coefficients at 95 % (Bonferroni); the rates are of each coefficient's own 95 %
interval, against a bound that a correct interval passes with 99.9 % probability.
"""

import warnings
from collections.abc import Callable

import numpy as np
import scipy

from slipangle import FitInfo, MagicCurve
from slipangle.errors import IdentifiabilityWarning
from slipangle.identify.tires.curves import SOUSA_TABLE_6_7, MagicCurveFit, magic_regression
from slipangle.numerics.multistart import Effort, fixed_cost
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

NAMES = ("B", "C", "D", "E", "S_h", "S_v")
PRINTED = {
    "mu_x": MagicCurve(B=10.3075, C=1.9157, D=2.6268, E=0.5182, S_h=0.0322, S_v=-0.2819),
    "mu_y": MagicCurve(B=-10.8138, C=-1.6192, D=2.7166, E=0.4118, S_h=-0.0036, S_v=0.0694),
}
NOISE = {"mu_x": 0.124, "mu_y": 0.063}
RATE_SEEDS = range(1, 41)


def stand_in(curve: str, *, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slip (ratio or rad), friction with noise, and the noise alone, of ``"mu_x"`` or ``"mu_y"``."""
    slip = np.linspace(-0.21, 0.21, 322) if curve == "mu_x" else np.deg2rad(np.linspace(-13.0, 13.0, 1268))
    noise = NOISE[curve] * np.random.default_rng([seed, len(slip)]).standard_normal(len(slip))
    return slip, PRINTED[curve](slip) + noise, noise


def truth(curve: str) -> np.ndarray:
    """Printed coefficients, B and C made positive together."""
    values = np.array([getattr(PRINTED[curve], n) for n in NAMES])
    values[:2] = np.abs(values[:2])
    return values


def reproduce(progress: Progress) -> Reproduction:
    """Fit both curves and count how often the intervals hold the coefficients."""
    low, high = SOUSA_TABLE_6_7
    joint = 1 - 0.05 / (2 * len(NAMES))
    records: list[Record] = []
    for k, name in enumerate(PRINTED):
        progress(0.1 * k, f"Magic Formula on {name}")
        slip, friction, _ = stand_in(name)
        info = _quietly(MagicCurveFit(lower=low, upper=high, level=joint), slip, friction)
        ends = info.interval(joint)
        for j, coefficient in enumerate(NAMES):
            true = truth(name)[j]
            here, (lower, upper) = float(info.values[j]), ends[j]
            bound, holds = f"{true:g} in {lower:.4g} to {upper:.4g}", bool(lower <= true <= upper)
            printed = float(getattr(PRINTED[name], coefficient))
            records.append(Record(f"table 6.8, {name}", f"{coefficient} [-]", printed, here, bound, holds))
    needed = int(scipy.stats.binom.ppf(0.001, len(RATE_SEEDS), 0.95))
    for k, name in enumerate(PRINTED):
        inside = _rates(name, lambda share, k=k: progress(0.2 + 0.4 * (k + share), "rates over seeds"))
        row, percent = f"table 6.8, {name}, {len(RATE_SEEDS)} noise seeds", 100 / len(RATE_SEEDS)
        for coefficient, count in zip(NAMES, inside, strict=True):
            what = f"share of 95 % intervals that hold {coefficient} [%]"
            records.append(Record.judged(row, what, None, percent * int(count), at_least=percent * needed))
    return Reproduction.told(__doc__, records)


def _rates(name: str, progress: Callable[[float], None]) -> np.ndarray:
    """How many seeds hold each coefficient in its 95 % profile interval.

    A value lies inside exactly when holding the coefficient there raises the cost by no more than the limit.
    """
    lower, upper = (np.array([getattr(c, n) for n in NAMES]) for c in SOUSA_TABLE_6_7)
    fit = MagicCurveFit(
        lower=SOUSA_TABLE_6_7[0], upper=SOUSA_TABLE_6_7[1], level=None, effort=Effort(starts=8, carried=2)
    )
    inside = np.zeros(len(NAMES), dtype=int)
    for k, seed in enumerate(RATE_SEEDS):
        progress(k / len(RATE_SEEDS))
        slip, friction, _ = stand_in(name, seed=seed)
        problem = magic_regression(slip[:, None], friction[:, None])
        values = _quietly(fit, slip, friction).values
        best = float(np.sum(problem.residual(values) ** 2))
        freedom = len(slip) - len(NAMES)
        limit = scipy.stats.t.ppf(0.975, freedom) ** 2 * best / freedom
        for j, value in enumerate(truth(name)):
            inside[j] += fixed_cost(problem, values, lower, upper, j, float(value))[0] - best <= limit
    return inside


def _quietly(fit: MagicCurveFit, slip: np.ndarray, friction: np.ndarray) -> FitInfo:
    """FitInfo of a fit whose warnings the intervals already tell."""
    with warnings.catch_warnings(action="ignore", category=IdentifiabilityWarning):
        info = fit.fit(slip, friction).fit_info
    if info is None:
        raise AssertionError
    return info
