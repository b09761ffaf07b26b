"""Predictions that leave every range the outputs were ever seen in: the sentences about them."""

from collections.abc import Sequence

import numpy as np

FAR = 100.0  # half ranges of an output from the middle of it, beyond which a prediction cannot be meant
FARTHER = 1e6  # the same where the training data are not known: those at hand may be short, or stand-ins


def astray(
    y: np.ndarray,
    measured: np.ndarray,
    *,
    outputs: Sequence[str],
    seen: tuple[np.ndarray, np.ndarray] | None,
    starts: Sequence[int],
    t: np.ndarray,
    what: str,
) -> dict[str, str]:
    """For each output whose prediction leaves any plausible range, where and how far.

    ``y`` and ``measured`` have the shape (n_samples, n_outputs); ``seen`` are the smallest and largest outputs of the
    training data, ``starts`` the first row of each experiment, ``what`` the name of the prediction.
    """
    low, high, far = measured.min(axis=0), measured.max(axis=0), FARTHER if seen is None else FAR
    if seen is not None:
        low, high = np.minimum(low, seen[0]), np.maximum(high, seen[1])
    centre, half = 0.5 * (high + low), 0.5 * (high - low)
    least, most = y.min(axis=0), y.max(axis=0)
    said = {}
    for i, name in enumerate(outputs):
        reach = far * half[i]
        if not half[i] > 0 or (most[i] - centre[i] <= reach and centre[i] - least[i] <= reach):
            continue
        k = int(np.argmax(np.abs(y[:, i] - centre[i]) > reach))
        experiment = int(np.searchsorted(starts, k, side="right")) - 1
        where = f" of the experiment from t = {t[starts[experiment]]:g} s" if len(starts) > 1 else ""
        worst = most[i] if most[i] - centre[i] > centre[i] - least[i] else least[i]
        said[name] = (
            f"the {what} of '{name}' goes astray: at sample {k - starts[experiment]}{where} (t = {t[k]:g} s) it gets "
            f"{far:g} times as far out as any sample of the data ({low[i]:.3g} to {high[i]:.3g}), then to {worst:.3g}; "
            "expected a model that follows them: ask for a stable one, or predict fewer steps ahead"
        )
    return said


def tenfold(size: float) -> float:
    """Samples in which an error grows tenfold by a pole of this modulus above 1."""
    return float(np.log(10) / np.log(size))


def growth(poles: np.ndarray, n: int) -> str:
    """Sentence about the largest pole where a free run of ``n`` samples blows an error up tenfold; else empty."""
    size = float(np.abs(poles).max(initial=0.0))
    if not size > 1 or n < tenfold(size):
        return ""
    return (
        f"the model is unstable: it has a pole of modulus {size:.6g}, so an error of its free run grows tenfold every "
        f"{tenfold(size):.3g} samples, and the training data last {n}; expected a stable model, unless the system is "
        "not: ask for one, choose other lags, or predict a few steps ahead only"
    )
