"""Every estimator says what it expects where it is given no `Dataset`."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import ParameterError
from slipangle.identify.car.identify_car import WholeCar
from slipangle.identify.linear.integrated import IntegratedARX
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2

CAR = Bicycle(params=SOUSA_TABLE_7_2, dt=0.02, outputs=("r",))
ESTIMATORS = {
    "ARX": sa.ARX(),
    "MultiARX": sa.MultiARX(),
    "StateSpace": sa.StateSpace(),
    "OutputError": sa.OutputError(),
    "Lure": sa.Lure(linear=sa.StateSpace()),
    "GreyBox": sa.GreyBox(start=CAR, free=("C_f",)),
    "NARX": sa.NARX(),
    "identify": WholeCar(mass=1500.0, wheelbase=2.7, l_f=1.2),
    "integrated": IntegratedARX(na=2, nb=1, order=1),
}


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("given", [np.zeros(50), {"u": np.zeros(50)}, None])
def test_no_data_set_is_said(name, given):
    with pytest.raises(
        ParameterError, match=rf"fit\(\) got {type(given).__name__}; expected a Dataset: read\(\) a log"
    ):
        ESTIMATORS[name].fit(given)


def test_models_and_verdicts_say_it_too():
    with pytest.raises(ParameterError, match=r"the model got ndarray; expected a Dataset"):
        CAR.simulate(np.zeros(50))
    with pytest.raises(ParameterError, match=r"validate\(\) got ndarray; expected a Dataset"):
        sa.validate(CAR, np.zeros(50))
