"""Mistakes in the choice of orders, in ARX models blended by speed and in networks that start from a linear model."""

from tests.mutants.listed import mistakes

ORDERS = "identify/linear/test_orders.py"

MUTANTS = [
    *mistakes(
        "identify/linear/order_trials.py",
        ORDERS,
        [
            (
                "orders: judged by a model that saw the stretch",
                "Fits(tested.others(), tested)",
                "Fits(tested.over(np.ones_like(lengths)), tested)",
            ),
            (
                "orders: a model that blows up may win",
                "stable=bool(lasting[c])",
                "stable=True",
            ),
            (
                "orders: of models alike the largest wins",
                "c.n_parameters if a else 0",
                "-c.n_parameters if a else 0",
            ),
            ("orders: v_x is an input at one speed", 'n != "v_x" or not speeds', 'n != "v_x" or len(speeds) < 2'),
        ],
    ),
    *mistakes(
        "identify/linear/orders.py",
        ORDERS,
        [("orders: delays are not tried", "for k in range(least[of[0]], most + 1)", "for k in range(1, 2)")],
    ),
    *mistakes(
        "identify/linear/orders.py",
        "identify/linear/test_delays.py",
        [("orders: no delay beyond the first search", "k - _ABOUT if k > LEVELS[-1] else 0", "0")],
    ),
    *mistakes(
        "identify/linear/waiting.py",
        "identify/linear/test_delays.py",
        [("state space: an input waits one sample less", "at + samples - 1  #", "at + samples - 2  #")],
    ),
    *mistakes(
        "identify/linear/delays.py",
        "identify/linear/test_delays.py",
        [
            ("delays: the loop is not looked for", "if found[i] == 0:", "if False:"),
            ("delays: a loop that past outputs show is no hint", "_STRONG * _answers", "0 * _answers"),
            ("delays: counted from the oldest lag", "np.cumsum(rise[::-1] / left", "np.cumsum(rise / left"),
        ],
    ),
    *mistakes(
        "identify/linear/candidate_runs.py",
        ORDERS,
        [
            ("orders: free run with its lags turned round", "ny, ny)[:, :, :, ::-1]", "ny, ny)"),
            ("orders: free run in C with its lags turned round", "((na - i) * ny", "((na - 1 - lags[c] + i) * ny"),
        ],
    ),
    *mistakes(
        "identify/linear/estimator.py",
        ORDERS,
        [("orders: BIC with the penalty of AIC", "d * math.log(n)", "2 * d")],
    ),
    *mistakes(
        "identify/linear/multi_arx.py",
        ORDERS,
        [
            (
                "ARX by speed: constant of the centred signals",
                "own[-1] + shift[:ny] - shifts @ own[:-1] if self.offset",
                "own[-1] if self.offset",
            ),
            ("ARX by speed: another speed is named", "speeds[int(np.argmin(held))]", "speeds[int(np.argmax(held))]"),
        ],
    ),
    *mistakes(
        "identify/networks/narx.py",
        "identify/networks/test_narx.py::test_the_start_is_the_arx_model_itself",
        [("linear start: sign of the past outputs", "*(-best.A)", "*best.A")],
    ),
    *mistakes(
        "identify/networks/training.py",
        "identify/networks/test_training.py",
        [
            (
                "linear start: a network that goes astray where it was trained may win",
                "self._own(params) > self.most",
                "False",
            ),
        ],
    ),
    *mistakes(
        "identify/linear/multi_arx.py",
        "identify/linear/test_statespace_unstable.py",
        [("ARX by speed: not asked whether unstable", "unstable_said(_poles(model), driven, self.offset)", '""')],
    ),
    *mistakes(
        "identify/linear/statespace_unstable.py",
        "identify/linear/test_statespace_unstable.py",
        [
            (
                "unstable systems: any pole outside the circle is one",
                "data.n_samples * gain > _SURE",
                "True",
            ),
            ("unstable systems: compared with no stable model", "max_radius=1.0", "max_radius=None"),
        ],
    ),
    *mistakes(
        "identify/networks/neural_statespace.py",
        "identify/networks/test_neural_statespace.py::test_training_starts_as_the_linear_state_space_of_the_same_order",
        [("linear start: the state instead of its change", "model.A - np.eye(self._n)", "model.A")],
    ),
]
