"""Table 6.4: neural tires fitted to friction curves of the simple Magic Formula.

Data: the curves of table 6.2, 200 points of slip from -100 to 100 (percent for the longitudinal, degrees for the
lateral curve), friction being force over the wheel load of 2500 * 9.81 / 4 N. Without noise. Inputs scaled to -1..1,
bounds of table 6.3, multiquadric functions in the RBF. The thesis calls the MLP's activation a sigmoid; with the
logistic function and these bounds its numbers are out of reach (RMSE of {1 1} at least 0.35 on the longitudinal
curve), with the hyperbolic tangent {1 1 1} comes out as printed to every digit, so that is what is used. Every fit
starts from 16 random points inside the bounds, seed 0, and knows nothing of the curve.

A printed number is met when ours is as good to the digits that are printed: R2 of 1.000 stands for 0.9995 and more.
"""

import time

import numpy as np

from slipangle.identify.judge.metrics import r2, rmse
from slipangle.identify.tires.curves import MLPCurveFit, NetworkCurveFit, RBFCurveFit
from slipangle.models.tires.neural import NeuralCurve
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_2
from slipangle.report.records import Record
from slipangle.report.tire_fits import curve_figure
from slipangle.reproduce import Progress, Reproduction

# R2, RMSE of mu_x, R2, RMSE of mu_y, average time [s]; digits as printed
PRINTED = {
    "RBF {1}": ("0.2248", "0.7055", "0.2546", "0.6922", 0.0190),
    "RBF {2}": ("0.9741", "0.1289", "0.9977", "0.0382", 0.1780),
    "RBF {3}": ("0.9978", "0.0374", "1.000", "0.0041", 0.7405),
    "RBF {4}": ("0.9998", "0.0117", "1.000", "0.0022", 0.6585),
    "RBF {5}": ("0.9784", "0.1179", "0.9954", "0.0687", 0.8540),
    "MLP {1 1}": ("0.9587", "0.1628", "0.9921", "0.0711", 0.0250),
    "MLP {2 2}": ("0.9997", "0.0155", "1.000", "0.0043", 0.2530),
    "MLP {3 3}": ("1.000", "0.0011", "1.000", "0.0024", 0.3305),
    "MLP {1 1 1}": ("0.9832", "0.1040", "0.9988", "0.0276", 0.1655),
    "MLP {2 2 2}": ("1.000", "0.0004", "1.000", "0.0028", 0.2865),
    "MLP {3 3 3}": ("1.000", "0.0004", "1.000", "0.0029", 0.6260),
}
TIME_LIMIT = 20.0  # s, for the whole table


def data() -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Slip ratio [-] and friction, slip angle [rad] and friction; 200 points each."""
    slip = np.linspace(-100.0, 100.0, 200)
    ratio, angle = slip / 100, np.deg2rad(slip)
    return (ratio, SOUSA_TABLE_6_2.longitudinal(ratio)), (angle, SOUSA_TABLE_6_2.lateral(angle))


def settings(label: str, *, seed: int = 0) -> NetworkCurveFit:
    """Fit of an architecture named as in the tables, such as ``"MLP {2 2}"``."""
    kind, _, sizes = label.partition(" ")
    numbers = tuple(int(n) for n in sizes.strip("{}").split())
    return RBFCurveFit(neurons=numbers[0], seed=seed) if kind == "RBF" else MLPCurveFit(hidden=numbers, seed=seed)


def half_digit(printed: str) -> float:
    """Half of the last printed digit.

    >>> round(half_digit("0.0155"), 6), half_digit("1.000")
    (5e-05, 0.0005)
    """
    return 0.5 * 10.0 ** -len(printed.partition(".")[2])


def compare(row: str, curve: str, printed: tuple[str, str], measured: np.ndarray, fitted: np.ndarray) -> list[Record]:
    """R2 and RMSE of one curve beside the printed ones, each met to its digits."""
    here_r2, here_rmse = float(r2(measured, fitted)), float(rmse(measured, fitted))
    least = float(printed[0]) - half_digit(printed[0])
    met, exact = here_rmse <= float(printed[1]) + half_digit(printed[1]), here_rmse <= float(printed[1])
    note = "" if exact else f"{curve} RMSE equals the printed digits"
    return [
        Record(row, f"{curve} R2 [-]", printed[0], here_r2, f">= {printed[0]}", here_r2 >= least),
        Record(row, f"{curve} RMSE [-]", printed[1], here_rmse, f"<= {printed[1]}", met, note),
    ]


def reproduce(progress: Progress) -> Reproduction:
    """Fit all eleven architectures to both curves."""
    curves = data()
    records: list[Record] = []
    shown: dict[str, list[NeuralCurve]] = {}
    began = time.process_time()
    for k, (label, printed) in enumerate(PRINTED.items()):
        progress(k / len(PRINTED), f"{label} on both friction curves")
        fits: list[NeuralCurve] = [settings(label).fit(slip, friction) for slip, friction in curves]
        if label in ("RBF {4}", "MLP {2 2}"):  # those of fig. 6.3
            shown[label] = fits
        for name, digits, (slip, friction), fit in zip(
            ("mu_x", "mu_y"), (printed[0:2], printed[2:4]), curves, fits, strict=True
        ):
            records += compare(f"table 6.4, {label}", name, digits, friction, fit(slip))
    seconds = time.process_time() - began
    printed_time, bound = round(2 * sum(p[4] for p in PRINTED.values()), 3), f"< {TIME_LIMIT:g}"
    note = "the thesis' times are of single solver runs on another computer; here 16 random starts each"
    what = "table 6.4, whole table", "process time of all 22 fits [s]"
    records.append(Record(*what, printed_time, seconds, bound, seconds < TIME_LIMIT, note))
    drawn = [{label: fits[k] for label, fits in shown.items()} for k in range(2)]
    return Reproduction.told(__doc__, records, [curve_figure(*curves[k], drawn[k], along=k == 0) for k in range(2)])
