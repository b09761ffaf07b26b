"""Expressions of channels: arithmetic as Python has it, and nothing else."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slipangle.data.expression import Expression, heading
from slipangle.errors import FormatError

RNG = np.random.default_rng(3)
VALUES = {"a": RNG.uniform(0.1, 2, 9), "b": RNG.uniform(-2, 2, 9), "x y": RNG.uniform(-1, 1, 9)}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a + b * 'x y' / 2 - 3", lambda a, b, x: a + b * x / 2 - 3),
        ("-a ** 2", lambda a, b, x: -(a**2)),
        ("atan2(b, a) + hypot(a, b)", lambda a, b, x: np.arctan2(b, a) + np.hypot(a, b)),
        ("sqrt(abs(b)) * sin(pi * 'x y')", lambda a, b, x: np.sqrt(np.abs(b)) * np.sin(np.pi * x)),
        ("min(a, b) + max(a, 1)", lambda a, b, x: np.minimum(a, b) + np.maximum(a, 1)),
        ("0 < b <= 1 or not a > 1", lambda a, b, x: ((b > 0) & (b <= 1)) | ~(a > 1)),
        ("acos('x y') + asin('x y') - atan(b)", lambda a, b, x: np.arccos(x) + np.arcsin(x) - np.arctan(b)),
    ],
)
def test_it_computes_what_it_says(text, expected):
    np.testing.assert_allclose(Expression(text)(VALUES), expected(*VALUES.values()), rtol=1e-14)


def test_heading_of_a_quaternion_is_that_of_the_rotated_x_axis():
    turns = Rotation.from_euler("ZYX", np.column_stack([np.linspace(0, 9, 50), 0.2 * RNG.normal(size=(50, 2))]))
    pointed = turns.apply([1.0, 0.0, 0.0])
    found = heading(*turns.as_quat().T)
    np.testing.assert_allclose(np.sin(found), pointed[:, 1] / np.hypot(*pointed[:, :2].T), atol=1e-12)
    np.testing.assert_allclose(np.diff(found), 9 / 49, atol=1e-9)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os')",
        "a.real",
        "a[0]",
        "[a for a in b]",
        "lambda: a",
        "a if b else a",
        "f'{a}'",
        "(a := 3)",
        "sin(a, b)",
        "sin(x=a)",
        "atan2(a)",
        "a b",
        "",
        "True",
        "1j",
        "a @ b",
        "(" * 240 + "a" + ")" * 240,
        "a + " * 200 + "a",
        "await a",
        "*a",
    ],
)
def test_what_is_no_arithmetic_is_refused_in_one_sentence(text):
    with pytest.raises(FormatError) as caught:
        Expression(text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_a_tower_of_powers_ends_at_once():
    assert Expression("9 ** 9 ** 9 ** 9")({}) == np.inf
