"""A Driver with its defaults, built from what a log of the car gives, on a dual track that is not its model."""

import pytest
from benchmarks.bench_driver import BOUNDS, Car

from slipangle.codegen.compiler import compiler, sentence


@pytest.mark.slow
@pytest.mark.skipif(compiler() is None, reason=sentence())
def test_iso_3888_at_24_m_per_s_from_raw_measurements():
    """One seed of the benchmark: true pose at 100 Hz, and a pose at 10 Hz that is 100 ms late."""
    car = Car("dual track")
    model = car.identified()
    for pose, bound in BOUNDS.items():
        assert car.error(model, pose, 0) < bound
