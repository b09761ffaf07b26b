"""A quarter of a minute of fuzzing, always the same inputs, and the whole minute as slow tests.

SLIPANGLE_FUZZ_SECONDS gives longer runs, SLIPANGLE_FUZZ_SEED others.

A clean end is a result or one sentence (a `SlipangleError`); a traceback, a crash, a warning of NumPy, more memory than
the limit, more time than the limit or a message of many lines is not.
"""

import os

import pytest

from tests.fuzz.runner import run
from tests.fuzz.targets import TARGETS


@pytest.mark.parametrize("of", [pytest.param(1, marks=pytest.mark.slow, id="all"), pytest.param(4, id="a quarter")])
@pytest.mark.parametrize("target", sorted(TARGETS))
def test_every_input_ends_in_a_result_or_a_sentence(target, of):
    seconds = float(os.environ.get("SLIPANGLE_FUZZ_SECONDS", "0")) / len(TARGETS)
    seed = int(os.environ.get("SLIPANGLE_FUZZ_SEED", "0"))
    tried, kept = run(target, seed, 10**9, seconds) if seconds else run(target, seed, TARGETS[target].inputs // of)
    assert not kept, "\n".join([f"{len(kept)} kinds of failure in {tried} inputs:", *kept])
    assert tried
