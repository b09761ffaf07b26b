"""Some seconds of fuzzing, always the same inputs, and the whole minute as slow tests.

SLIPANGLE_FUZZ_SECONDS gives longer runs of the slow ones, SLIPANGLE_FUZZ_SEED others.

A clean end is a result or one sentence (a `SlipangleError`); a traceback, a crash, a warning of NumPy, more memory than
the limit, more time than the limit or a message of many lines is not.
"""

import os

import pytest

from tests.fuzz.runner import end_well, run
from tests.fuzz.targets import TARGETS

SEED = int(os.environ.get("SLIPANGLE_FUZZ_SEED", "0"))


def require_clean_ends(target, count, seconds=float("inf")):
    tried, kept = run(target, SEED, count, seconds)
    assert not kept, "\n".join([f"{len(kept)} kinds of failure in {tried} inputs:", *kept])
    assert tried


@pytest.mark.parametrize("half", [0, 1])
def test_an_eighth_of_the_inputs_ends_in_a_result_or_a_sentence(half):
    """One process tries half of the targets, as most of its time goes into its start; what fails is tried alone."""
    counts = {target: TARGETS[target].inputs // 8 for target in sorted(TARGETS)[half::2]}
    assert min(counts.values()) > 0
    left = sorted(counts.keys() - end_well(counts, SEED))
    for target in left:
        require_clean_ends(target, counts[target])
    assert not left, "these end well alone, but not in a process that tried others before"


@pytest.mark.slow
@pytest.mark.parametrize("target", sorted(TARGETS))
def test_every_input_ends_in_a_result_or_a_sentence(target):
    seconds = float(os.environ.get("SLIPANGLE_FUZZ_SECONDS", "0")) / len(TARGETS)
    if seconds:
        require_clean_ends(target, 10**9, seconds)
    else:
        require_clean_ends(target, TARGETS[target].inputs)
