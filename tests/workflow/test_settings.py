"""Settings files that are no job: one sentence each."""

import pytest

from slipangle.errors import ConfigError
from slipangle.workflow.settings import read_settings

JOB = """
title = "job"
[data]
file = "log.csv"
{data}
[[model]]
name = "a"
kind = "arx"
{model}
"""


@pytest.fixture
def job(tmp_path):
    def write(text=None, data="", model=""):
        path = tmp_path / "job.toml"
        path.write_text(text if text is not None else JOB.format(data=data, model=model))
        return path

    return write


def test_the_job_itself_is_read(job):
    assert read_settings(job(data="rate = 20")).data.rate == 20.0


@pytest.mark.parametrize("opened", ["[", "{a=", "a."])
def test_nesting_without_end(job, opened):
    with pytest.raises(ConfigError, match=r"nested too deeply|not valid TOML|no entry"):
        read_settings(job("a = " + opened * 2000 if opened != "a." else "a." * 2000 + "a = 1"))


@pytest.mark.parametrize("digits", [16, 400, 5000])
@pytest.mark.parametrize("where", ["data", "model"])
def test_numbers_without_end(job, digits, where):
    entry = {"data": "rate = ", "model": "na = "}[where] + "9" * digits
    with pytest.raises(ConfigError, match=r"expected a number of at most 16 digits|not valid TOML") as caught:
        read_settings(job(**{where: entry}))
    assert len(str(caught.value)) < 500


def test_a_message_repeats_at_most_a_line(job):
    for entry in ('hold = "' + "x" * 100_000 + '"', "inputs = " + str(list(range(50_000))), "x" * 100_000 + " = 1"):
        with pytest.raises(ConfigError) as caught:
            read_settings(job(data=entry))
        assert len(str(caught.value)) < 2001


def test_a_model_has_a_name(job):
    with pytest.raises(ConfigError, match="a model's name is empty"):
        read_settings(job(text=JOB.replace('name = "a"', 'name = " "').format(data="", model="")))
