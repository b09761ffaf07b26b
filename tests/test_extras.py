"""What extras bring is asked for by name, in one sentence, and nothing else needs it."""

import subprocess
import sys

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import ConfigError
from slipangle.identify.networks.narx_free_run import FreeRunNARX
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams

PARAMS = NonlinearBicycleParams(mass=1000, inertia_z=1200, wheelbase=2.4, l_f=1.3, C_f=8e4, C_r=9e4)
START = NonlinearBicycle(params=PARAMS, dt=0.05, outputs=("r",))


def drive():
    t = np.arange(200) * 0.05
    inputs = {"delta": 0.05 * np.sin(t) + 0.01 * np.sin(7 * t), "v_x": 20.0 + np.sin(0.3 * t)}
    return sa.Dataset.from_arrays(inputs, {"r": 0.3 * np.sin(t - 0.1)}, 0.05)


@pytest.mark.parametrize(
    ("estimator", "job"),
    [
        (sa.NARX(na=2, nb=2), "fitting a NARX network"),
        (FreeRunNARX(start=sa.NARX(na=2, nb=2)), "fitting a NARX network"),
        (sa.NeuralStateSpace(order=2), "fitting a neural state space"),
        (sa.Joint(start=START, free=("C_f",)), "fitting physics with a network"),
        (sa.Hybrid(base=START), "fitting a hybrid model"),
    ],
)
@pytest.mark.parametrize("absent", ["jax", "optax"])
def test_a_network_asks_for_its_extra_by_name(estimator, job, absent, monkeypatch):
    monkeypatch.setitem(sys.modules, absent, None)
    with pytest.raises(ConfigError, match=rf"^{job} needs {absent}, which .* pip install 'slipangle\[neural\]'$"):
        estimator.fit(drive())


def test_all_but_training_does_without_the_extras():
    """Every public name, the command line and the demo are there in a Python that has none of what extras bring."""
    script = """
import sys
absent = "jax optax ray optuna asammdf h5py pandas polars pyarrow rosbags xarray matplotlib"
for name in absent.split():
    sys.modules[name] = None
import slipangle as sa
for name in sa.__all__:
    getattr(sa, name)
from slipangle.cli import main
from slipangle.workflow import demo, job, kinds
print(len(sa.__all__))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == len(sa.__all__)


def test_statistics_and_filters_are_loaded_by_what_needs_them():
    """They take as long as the rest of a command's start, and one of a controller, or a worker's, needs neither."""
    code = "import sys, slipangle.cli, slipangle.workflow.job; print({'scipy.signal', 'scipy.stats'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
