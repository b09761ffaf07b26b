"""Mistakes in metrics, units, identification, control, paths, sensors and manoeuvres."""

from tests.mutants.listed import mistakes

MEASURES = "oracles/test_measures.py"
PLANS = "oracles/test_control.py"
PATH = "paths/test_path.py"
BLACK_BOX = "oracles/test_black_box.py"

MUTANTS = [
    *mistakes(
        "identify/judge/metrics.py",
        MEASURES,
        [
            (
                "VAF computed as R2",
                "np.var(measured - predicted, axis=0) / np.var",
                "np.mean((measured - predicted) ** 2, axis=0) / np.var",
            ),
            ("R2 about zero", "np.sum(centred**2, axis=0)", "np.sum(measured**2, axis=0)"),
            ("RMSE of the sum", "np.sqrt(np.mean((measured", "np.sqrt(np.sum((measured"),
            (
                "fit of the squared norm",
                "100 * (1 - np.linalg.norm(measured - predicted, axis=0) /",
                "100 * (1 - np.linalg.norm(measured - predicted, axis=0) ** 2 /",
            ),
        ],
    ),
    *mistakes(
        "units.py",
        MEASURES,
        [
            ("km/h the wrong way round", '"km/h": 1 / 3.6', '"km/h": 3.6'),
            ("rpm as half turns", "math.pi / 30", "math.pi / 60"),
            ("N/deg the wrong way round", "180 / math.pi", "math.pi / 180"),
            ("from SI multiplies", "dtype=float) / _UNITS", "dtype=float) * _UNITS"),
        ],
    ),
    # ---- identification
    *mistakes(
        "identify/physics/first_sample.py",
        "identify/physics/test_first_sample.py",
        [
            ("first sample: all noise alike", "noise.get(name, 0.0)", "noise.get(name, 0.0) and 1e-9"),
            ("first sample: states logged beside are exact", "noise |= _noise_beside", "_ = _noise_beside"),
        ],
    ),
    *mistakes(
        "numerics/covariance.py",
        "identify/physics/test_loose_parameters.py",
        [
            ("covariance: what moves nothing is known", "size <= _ROUNDING * max", "size < -_ROUNDING * max"),
            ("covariance: two that move together as if one each", "np.copysign(np.inf, together)", "np.inf"),
        ],
    ),
    *mistakes(
        "models/model.py",
        "identify/physics/test_loose_parameters.py",
        [
            (
                "FitInfo: a product as open as its factors",
                "np.any(np.abs(by @ self.loose)",
                "np.any(np.abs(by) @ self.loose",
            )
        ],
    ),
    *mistakes(
        "identify/linear/arx.py",
        "identify/linear/test_arx.py",
        [
            (
                "ARX: order of the lags",
                "for i in range(1, na + 1) for c in y]",
                "for i in range(na, 0, -1) for c in y]",
            ),
            ("ARX: an input one sample late", "[(m - lag) * nc + u[i] for", "[(m - lag + 1) * nc + u[i] for"),
            (
                "ARX: sign of the constant",
                "theta[-1] + self.y_mean - self._means",
                "theta[-1] - self.y_mean - self._means",
            ),
            ("ARX: sign of A", "A = -theta[: na * ny]", "A = theta[: na * ny]"),
            (
                "ARX: samples of two experiments joined",
                "m, nc = max(na, used[-1][0]), len(names)",
                "m, nc = max(na, used[0][0]), len(names)",
            ),
        ],
    ),
    *mistakes(
        "models/black_box/continuous.py",
        "identify/linear/test_transfer_function.py",
        [
            (
                "transfer functions: the last part of a sample first",
                "(one.older, one.whole + 1), (one.newer, one.whole)",
                "(one.newer, one.whole + 1), (one.older, one.whole)",
            ),
        ],
    ),
    *mistakes(
        "models/black_box/continuous.py",
        "models/analysis/test_delays.py",
        [("a fit in continuous time: its delay is sure", "self.delay + float(move[-1])", "self.delay + 0.0")],
    ),
    *mistakes(
        "numerics/held.py",
        "models/analysis/test_delays.py",
        [
            ("late inputs: delay of whole samples only", "max(delay - whole * h, 0.0)", "max(0.0, 0.0)"),
            (
                "late inputs: the newer part is the older",
                "A_rest @ B_late[:, 0], B_rest[:, 0], whole",
                "B_rest[:, 0], A_rest @ B_late[:, 0], whole",
            ),
            ("late inputs: what came first does not move on", "A_rest @ B_late[:, 0]", "B_late[:, 0]"),
        ],
    ),
    *mistakes(
        "models/analysis/delays.py",
        "models/analysis/test_delays.py",
        [
            (
                "sampled: the newer part acts late",
                "(part.newer, part.whole), (part.older, part.whole + 1)",
                "(part.older, part.whole), (part.newer, part.whole + 1)",
            ),
            ("sampled: what acts at once is lost where late", "+= system.D[:, j]", "+= 0.0 * system.D[:, j]"),
            (
                "to continuous time: the part of a sample is lost",
                "inverse @ linalg.expm(F * part) @ both",
                "inverse @ both",
            ),
            ("to continuous time: any past inputs are a delay", "if error(part) > _SAME or", "if"),
            (
                "to continuous time: interpolation of whole samples",
                "float(weights @ np.arange(len(weights)))",
                "float(np.argmax(weights))",
            ),
        ],
    ),
    *mistakes(
        "models/analysis/linearised.py",
        "models/analysis/test_delays.py",
        [
            ("late inputs lead", "np.exp(-s[:, None, None] * self.delay)", "np.exp(s[:, None, None] * self.delay)"),
            (
                "a late step begins at a sample",
                "max(first * h - float(model.delay[j]), 0.0)",
                "max(0.0 * first, 0.0)",
            ),
        ],
    ),
    *mistakes(
        "models/black_box/arx.py",
        "models/analysis/test_delays.py",
        [("estimates of ARX with the sign of the polynomial", "= -value", "= value")],
    ),
    *mistakes(
        "models/black_box/polynomial.py",
        "models/analysis/test_delays.py",
        [("estimates of B and F change places", "B=both[:nu], F=both[nu:]", "B=both[nu:], F=both[:nu]")],
    ),
    *mistakes(
        "models/analysis/linearize.py",
        "models/analysis/test_delays.py",
        [
            (
                "bands of data models twice as wide",
                "info.values + sign * SHARE * d",
                "info.values + 2 * sign * SHARE * d",
            )
        ],
    ),
    *mistakes(
        "report/parameters.py",
        "report/test_tables.py",
        [
            ("an open estimate is no fault by its name", " and math.isfinite(half))", ")"),
            ("references stay in radians", "published(factor * known[name], 6)", "published(known[name], 6)"),
        ],
    ),
    *mistakes(
        "report/diagnostics.py",
        "report/test_plots.py",
        [("intervals drawn by their upper half", "np.abs(ends).max(axis=1)", "np.abs(ends[:, 1])")],
    ),
    *mistakes(
        "identify/linear/transfer_function.py",
        "identify/linear/test_transfer_function.py",
        [
            (
                "transfer functions: gains of another time",
                "self.order - np.arange(self.gains, dtype=float)",
                "self.order + 0.0 * np.arange(self.gains)",
            )
        ],
    ),
    *mistakes(
        "identify/linear/continuous.py",
        "identify/linear/test_process.py",
        [
            ("late input: the record's first sample for what was before it", "self.unknown if cut else 0", "0"),
            ("continuous time: how a first state fades tells nothing", "gains + other @ states", "gains"),
            (
                "process models: fitted to what holds nothing",
                "    require_identifiable(cut.data, len(cut.names))\n",
                "",
            ),
            ("late input: no record is used whole", "return ends[0] if doubt else ends[1]", "return ends[0]"),
        ],
    ),
    *mistakes(
        "identify/linear/scales.py",
        "identify/linear/test_scales.py",
        [
            (
                "state spaces: covariance in other units than the estimates",
                "info.covariance * np.outer(by, by)",
                "info.covariance",
            )
        ],
    ),
    *mistakes(
        "models/black_box/statespace.py",
        "identify/linear/test_scales.py",
        [
            (
                "state spaces: first states of outputs in unlike units",
                "np.isfinite(size).all() and size.min() > 0",
                "size.min() < 0",
            )
        ],
    ),
    *mistakes(
        "models/black_box/lagged.py",
        BLACK_BOX,
        [
            ("lags: delay one too long", "max(self.nk - 1, 0)", "max(self.nk, 0)"),
            (
                "lags: inputs of the state in reverse",
                "for i in range(1, self._reach + 1))])",
                "for i in range(self._reach, 0, -1))])",
            ),
        ],
    ),
    *mistakes(
        "models/black_box/arx.py",
        BLACK_BOX,
        [("ARX model: sign of eqs. 4-1, 4-2 as printed", "[*(-self.A), *self.B]", "[*self.A, *self.B]")],
    ),
    *mistakes(
        "models/black_box/statespace.py",
        BLACK_BOX,
        [
            ("state space: predictor forgets D", "[self.B - K @ D, K]", "[self.B, K]"),
            ("state space: gain of the sample after", "np.linalg.solve(self.A, self.K)", "self.K"),
            ("state space: output offset taken off", "shifted(y, self.y_offset)", "shifted(y, -self.y_offset)"),
        ],
    ),
    *mistakes(
        "models/black_box/polynomial.py",
        BLACK_BOX,
        [
            ("ARMAX: sign of the innovation", "(c - a)[:, None]", "(a - c)[:, None]"),
            ("polynomial: direct input a sample late", "np.where(direct, A @ B, B)", "np.where(direct, B, B)"),
            ("Box-Jenkins: A counted as C", "K[last, 0] -= A", "K[last, 0] += A"),
        ],
    ),
    *mistakes(
        "models/wrappers/hybrid.py",
        BLACK_BOX,
        [
            ("sensor offsets: wrong way round", "(u[i] - zeros.get", "(u[i] + zeros.get"),
            (
                "sensor lag: straight lines",
                "return line + bend, 1.0 - left - line - 2.0 * bend",
                "return line, 1.0 - left - line",
            ),
            ("sensor lag: time constant over one", "math.exp(-1.0 / lag)", "math.exp(-lag)"),
            ("sensor lag: the input before twice as old", "two * x[n + 2 * j + 1]", "two * seen[i]"),
        ],
    ),
    *mistakes(
        "models/wrappers/multi_arx.py",
        BLACK_BOX,
        [("speed weights: cubic", "t * t * (3.0 - 2.0 * t)", "t * t * (3.0 - t)")],
    ),
    *mistakes(
        "reproduce/plants/narendra.py",
        BLACK_BOX,
        [("Narendra: lag of the input", "u[k - 1], u[k - 2]", "u[k - 2], u[k - 1]")],
    ),
    *mistakes(
        "estimate/window.py",
        "estimate/test_moving_horizon.py::test_a_windows_steps_that_are_repeated_are_those_written_out",
        [
            ("window: steps before do not count", "ca.mtimes(F[0], ca.jacobian(x, b))", "ca.jacobian(x, b)"),
            ("window: repeated with the input to come", "[x, u[self.width :", "[x, u[self.width + 1 :"),
        ],
    ),
    *mistakes(
        "estimate/filter.py",
        "estimate/test_one_state.py",
        [
            ("Kalman: a single state makes two", "ca.vertcat(later, z[nx:, 0])", "ca.vertcat(later, z[nx:])"),
            ("Kalman: nor may nothing be cut off it", "new[nx + nq :, 0])", "new[nx + nq :])"),
        ],
    ),
    *mistakes(
        "estimate/filter.py",
        "estimate/test_ekf.py",
        [
            (
                "Kalman: sign in Joseph's form",
                "keep = kind.eye(n) - ca.mtimes(gain, h)",
                "keep = kind.eye(n) + ca.mtimes(gain, h)",
            ),
            (
                "Kalman: deviation for variance",
                "settings.noise(model.outputs[i]) ** 2",
                "settings.noise(model.outputs[i])",
            ),
            ("Kalman: outputs counted twice", "left = error[i] - seen[i] * ca.mtimes(h, shift)", "left = error[i]"),
            ("Kalman: process noise not over time", "ca.mtimes(P, F.T)) + Q * dt", "ca.mtimes(P, F.T)) + Q"),
            ("Kalman: predicts with the input to come", "[z, before], corrected)", "[z, u], corrected)"),
        ],
    ),
    *mistakes(
        "estimate/measurements.py",
        "estimate/test_observer.py",
        [("late outputs: counted when they arrive", "row = rows[-1 - steps]", "row = rows[-1]")],
    ),
    *mistakes(
        "estimate/recursive.py",
        "estimate/test_observer.py",
        [
            (
                "late outputs: forgets what it knew then",
                "self._rows[k + 1].z[:], self._rows[k + 1].P[:] = self._z_new, self._P_new",
                "pass",
            )
        ],
    ),
    *mistakes(
        "data/quality/delay.py",
        "data/quality/test_inspect.py::test_a_pure_delay_is_found_between_the_samples",
        [("delay: leads for lags", "np.exp(2j * np.pi * np.outer(lags", "np.exp(-2j * np.pi * np.outer(lags")],
    ),
    *mistakes(
        "data/quality/smooth.py",
        "data/quality/test_smooth.py",
        [
            ("smoothing: the nearest samples tell the noise", "np.abs(at) > near", "np.abs(at) >= 0"),
            ("smoothing: noise is what the shortest window leaves", "if error.min() < _BETTER * error[0] else 0", ""),
            ("smoothing: steps are noise", "alike = _STEPPED if", "alike = _ALIKE if"),
        ],
    ),
    *mistakes(
        "identify/car/rack.py",
        "identify/car/test_rack.py",
        [
            ("a rack that turns less", "at + angle * (1.0 + more)", "at + angle * (1.0 - more)"),
            ("a rack is bent from straight ahead on", "[0.0, *_NODES], [0.0, *shares]", "_NODES, shares"),
            ("a rack without a gain of its own", '(*final.free, "steering_gain")', "(*final.free,)"),
        ],
    ),
    *mistakes(
        "identify/car/widened.py",
        "identify/car/test_widened.py",
        [
            ("a floor on top of the noise", "np.hypot(limits[i] - value,", "np.add(abs(limits[i] - value),"),
            ("samples as far apart as the car is slow", "quick, means = dt / follows", "quick, means = dt * follows"),
            ("an interpolated delay smooths nothing", "f * (1.0 - f) ** 2", "0.0 * f"),
        ],
    ),
    *mistakes(
        "data/quality/plausible.py",
        "data/quality/test_plausible.py",
        [
            ("a late yaw rate is swapped", " and large > abs(small)", ""),
            ("swapped channels by their size alone", "abs(slope) / 0.5) < 1", "1.0) < 1"),
        ],
    ),
    *mistakes(
        "data/quality/slow_motion.py",
        "data/quality/test_plausible.py",
        [
            ("understeer of a yaw rate with its offset", "true = r - value", "true = r"),
            ("understeer in proportion up to the limit", "v * (v * true) ** 3", "v * (v * true)"),
        ],
    ),
    *mistakes(
        "data/quality/stuck.py",
        "data/quality/test_plausible.py",
        [("a coarse channel is stuck", "_COARSE * finest if usual < _COARSE * finest else 0.0", "0.0")],
    ),
    *mistakes(
        "identify/car/late.py",
        "identify/car/test_braking.py::test_how_late_a_speed_is_logged_is_told",
        [("late: sign of an input's lateness", "for seconds in (h, -h)", "for seconds in (-h, h)")],
    ),
    *mistakes(
        "identify/car/structures.py",
        "identify/car/test_structures.py::test_relaxation_lengths_of_both_axles_are_drawn_to_each_other",
        [("structures: lengths drawn apart", "((one, 1.0), (other, -1.0))", "((one, 1.0), (other, 1.0))")],
    ),
    *mistakes(
        "identify/car/effects.py",
        "identify/car/test_shape.py::test_tires_that_yield_as_a_brush_are_in_the_intervals",
        [("brushes: on the same curve", "with_values(brush=1.0, ", "with_values(brush=0.0, ")],
    ),
    *mistakes(
        "identify/car/logged_speed.py",
        "identify/car/test_braking.py::test_loads_follow_a_noisy_speed_slowly",
        [
            (
                "loads: as slow as without noise",
                "best.fun < cost(first)",
                "best.fun > cost(first)",
            )
        ],
    ),
    # ---- control
    *mistakes(
        "optimal/ocp.py",
        (MEASURES, PLANS, "optimal/test_ocp.py::test_corridor_keeps_the_vehicle_between_the_edges"),
        [
            ("OCP: sign of e_y", "cos(psi) * dy - sin(psi) * dx", "cos(psi) * dy + sin(psi) * dx"),
            ("OCP: sign of e_psi", 'values["psi"] - psi', 'psi - values["psi"]'),
            ("OCP: edges of the corridor swapped", "half - right, left - half", "half - left, right - half"),
            ("OCP: changes over long stages cost more", "np.outer(1 / self._apart, s)", "np.outer(self._apart, s)"),
        ],
    ),
    *mistakes(
        "optimal/realtime/interpreted_qp.py",
        PLANS,
        [
            (
                "QP: sign of a constraint's value",
                "bounds[:, 0] - L[:, -1], bounds[:, 1] - L[:, -1]",
                "bounds[:, 0] + L[:, -1], bounds[:, 1] + L[:, -1]",
            ),
            ("QP: rate limit forgets the input before", "np.vstack([applied, u[:-1]])", "np.vstack([u[:1], u[:-1]])"),
        ],
    ),
    *mistakes(
        "models/repeated.py",
        (
            "optimal/realtime/test_repeated_steps.py",
            "estimate/test_ekf.py::test_steps_that_are_repeated_are_those_written_out",
        ),
        [
            (
                "steps begin without derivatives",
                "self.carried.column(self.start, ca.SX.eye(n)",
                "self.carried.column(self.start, 0.5 * ca.SX.eye(n)",
            ),
            ("the step before the last is taken", "last=self.times % 2", "last=1"),
            (
                "parameters move no step",
                "moved = [i for i in range(v.shape[0]) if",
                "moved = [i for i in range(equations.n_inputs) if",
            ),
            ("inputs act in the last step alone", "by_v + ca.mtimes(by_y, D)", "by_v + 0 * D"),
            ("late inputs are of no state", " + ca.mtimes(D, v_b[found.moved, :])", ""),
        ],
    ),
    *mistakes(
        "optimal/ocp.py",
        "optimal/test_ocp.py",
        [
            ("any psi is a heading", "or not set(POSE) <= {*self.model.states}:", "or 'psi' not in self.model.states:"),
            ("ends are as soft as the way there", 'f"{name}{AT_END}" if softened else name', "name"),
        ],
    ),
    *mistakes(
        "optimal/lap/profile.py",
        "optimal/lap/test_stages.py",
        [("a closed line is gone round once", "_LAPS, _SAME = 200,", "_LAPS, _SAME = 1,")],
    ),
    *mistakes(
        "optimal/realtime/curvature.py",
        "optimal/realtime/test_curvature.py",
        [
            ("steps bend nothing behind them", "column(first, G + second)", "column(first, second)"),
            (
                "what is before the steps bends nothing",
                "_hessian(at_node + behind + before, z)",
                "_hessian(at_node + behind, z)",
            ),
            ("late inputs bend by their start alone", "by_v + first[n:]", "first[n:]"),
            ("what follows the steps is straight", " + mixed + mixed.T", ""),
        ],
    ),
    *mistakes(
        "optimal/realtime/qp.c",
        (PLANS, "optimal/realtime/test_qp.py::test_same_as_daqp"),
        [
            (
                "QP in C: sign of the gradient in the residual",
                "fabs(z[a] + q->g[a] + forces[a])",
                "fabs(z[a] - q->g[a] + forces[a])",
            ),
            (
                "QP in C: sign in the second of two pivots",
                "d * old_next[j + 1] - off * off",
                "d * old_next[j + 1] + off * off",
            ),
            (
                "QP in C: lower limits pull up",
                "sign > 0 ? q->hi[p] : -q->lo[p], plain",
                "sign > 0 ? q->hi[p] : q->lo[p], plain",
            ),
        ],
    ),
    *mistakes(
        "optimal/realtime/riccati.c",
        "optimal/realtime/test_riccati.py::test_the_answer_is_the_condensed_solvers",
        [
            (
                "QP by stages: changes of input pull together",
                "- (NV ? change[j] * unit[AT(j) + b] : v_all(0.0));",
                "+ (NV ? change[j] * unit[AT(j) + b] : v_all(0.0));",
            )
        ],
    ),
    *mistakes(
        "optimal/realtime/rows.c",
        "optimal/realtime/test_riccati.py::test_the_answer_is_the_condensed_solvers",
        [
            (
                "QP by stages: price of an excess without its own slope",
                "price = plain + q->square[i] * (over - plain) / (stiff + q->square[i]);",
                "price = plain + q->square[i] * over / (stiff + q->square[i]);",
            )
        ],
    ),
    *mistakes(
        "optimal/realtime/solver.c",
        "optimal/test_never_dearer.py::test_from_states_of_a_runaway_the_tank_is_still_held",
        [
            (
                "begun plans: which one is cheaper",
                "2 * cost < s->cost - DEARER * fabs(s->cost)",
                "2 * cost > s->cost - DEARER * fabs(s->cost)",
            )
        ],
    ),
    *mistakes(
        "optimal/joined.py",
        "optimal/test_rates_of_duration.py::test_no_input_changes_faster_than_its_rate",
        [
            (
                "begun plans: rates over the whole duration",
                'span = known["duration"] / base.horizon',
                'span = known["duration"]',
            )
        ],
    ),
    *mistakes(
        "optimal/extended.py",
        "optimal/test_rates_of_duration.py::test_no_input_changes_faster_than_its_rate",
        [
            (
                "begun plans: an input before that stays",
                "stack([u[self.base.inputs.index(n)] for n in names])",
                "later[self.n_states - len(names) :]",
            )
        ],
    ),
    *mistakes(
        "identify/linear/inside.py",
        "identify/test_stability.py::test_a_pole_that_grows_more_slowly_than_the_training_data_show_is_held",
        [("poles outside: none gives way", "TIE * found.error", "0 * found.error")],
    ),
    *mistakes(
        "identify/linear/inside.py",
        "identify/test_stability.py::test_a_pole_outside_that_held_out_data_say_nothing_for_is_held",
        [("poles outside: one that nothing bears out stays", "modulus(model.A) <= SETTLED", "modulus(model.A) >= 0")],
    ),
    *mistakes(
        "identify/car/play.py",
        "identify/car/test_play.py",
        [
            ("play: looked for nowhere", "if not found > max(", "if found > max("),
            ("play: taken up on the wrong side", "max(at, angle - half), angle + half", "max(at, angle - half), angle"),
        ],
    ),
    *mistakes(
        "data/quality/swapped.py",
        "data/quality/test_swapped.py",
        [
            ("swapped: a steering that comes first too", "behind <= -max(", "abs(behind) >= max("),
            ("swapped: a_y at one speed", "not any(low < now < high", "any(low < now < high"),
        ],
    ),
    *mistakes(
        "optimal/realtime/solver.c",
        "control/test_limits_missed.py",
        [("limits missed: no turn looks everywhere", "s->misses % RETRIES == 0", "s->misses < 0")],
    ),
    *mistakes(
        "optimal/realtime/saddle.c",
        "optimal/test_maxima.py",
        [("exact Hessian: iterations that ran out are solved", "if (better || (surely && (", "if (better || (0 && (")],
    ),
    *mistakes(
        "optimal/realtime/saddle.c",
        "optimal/test_maxima.py::test_the_top_of_a_hill_is_left",
        [
            (
                "exact Hessian: which sign of a pivot is a maximum",
                "r->R[i * NU * NU + j * NU + j] < -FALLS * r->top",
                "r->R[i * NU * NU + j * NU + j] > FALLS * r->top",
            ),
            ("exact Hessian: back to a maximum from what is better", "if (!better)", "if (better)"),
        ],
    ),
    *mistakes(
        "optimal/realtime/interior.c",
        "optimal/realtime/test_riccati.py",
        [
            (
                "QP by stages: which side holds a row",
                "r->sign[i] = up > 0 ? 1 : down < 0 ? -1 : 0;",
                "r->sign[i] = up > 0 ? -1 : down < 0 ? 1 : 0;",
            )
        ],
    ),
    *mistakes(
        "optimal/realtime/solver.c",
        PLANS,
        [
            ("solver in C: S weight in the gradient", "q->g[a - NU] -= c * change;", "q->g[a - NU] += c * change;"),
            (
                "solver in C: sign of a state limit",
                "q->lo[QN + QR + row] = b[0] - v",
                "q->lo[QN + QR + row] = b[0] + v",
            ),
        ],
    ),
    *mistakes(
        "optimal/realtime/solver.c",
        "control/test_usual_call.py::test_edges_of_a_corridor_become_limits_as_elsewhere",
        [("corridor in C: half a car outside", "low = HALF_WIDTH - right", "low = -right - HALF_WIDTH")],
    ),
    *mistakes(
        "optimal/realtime/solver.c",
        "optimal/realtime/test_realtime.py::test_a_plan_is_the_same_whatever_the_work_area_holds",
        [
            (
                "solver in C: a linearisation for other exogenous inputs",
                "!memcmp(s->w + first * NW, s->ahead_w + first * NW, sizeof(double) * NW * many) &&",
                "1 &&",
            )
        ],
    ),
    *mistakes(
        "optimal/realtime/solver.c",
        "optimal/test_joined.py::test_the_shortest_time_between_two_rests_is_known",
        [("solver in C: stalled where rounding ends", "near && whole <= ROUNDED && back(s, whole) ? SOLVED :", "")],
    ),
    *mistakes(
        "optimal/realtime/solver.c",
        "control/test_begun_anew.py::test_thrown_far_off_and_back_it_plans_at_once",
        [
            (
                "solver in C: no second start where the first leads beyond all numbers",
                "return status == NOT_FINITE || status == FAILED ||",
                "return status == FAILED ||",
            )
        ],
    ),
    *mistakes(
        "optimal/realtime/solver.c",
        "optimal/test_agreement.py::test_limits_that_are_kept_only_elsewhere_are_kept",
        [
            (
                "solver in C: limits that are missed are not looked for elsewhere",
                "int ended = begin_at(s, same ? ROLL_OUT : STAY);",
                "int ended = INFEASIBLE;",
            )
        ],
    ),
    *mistakes(
        "optimal/realtime/solver.c",
        "optimal/test_agreement.py::test_an_obstacle_straight_ahead_is_passed",
        [("solver in C: mirrored about where it is", "int same = most <= SETTLED * SCALE[j];", "int same = 0;")],
    ),
    *mistakes(
        "optimal/realtime/solver.c",
        "optimal/test_grip.py",
        [("solver in C: small steps are whole ones", "s->reach = GENTLE;", "s->reach = INFINITY;")],
    ),
    *mistakes(
        "optimal/realtime/solver.c",
        "optimal/realtime/test_unstable.py",
        [
            ("solver in C: a blurred optimum is one", "return left > BLURRED * cost;", "return 0;"),
        ],
    ),
    *mistakes(
        "optimal/stretched.py",
        "optimal/test_stretched.py",
        [("stretched steps: the finer ones are not", "substeps=FINER * model.substeps", "substeps=model.substeps")],
    ),
    *mistakes(
        "control/watch.py",
        "control/test_watch.py",
        [
            (
                "watch: a yaw rate of the other sign agrees",
                "if abs(between - self._turned) > APART * most + left:",
                "if abs(abs(between) - turned) > APART * most + left:",
            ),
            (
                "watch: farther is as near",
                "self._nearest + self._far else RECEDING",
                "self._nearest + 1e9 else RECEDING",
            ),
        ],
    ),
    *mistakes(
        "export/models.py",
        "export/test_models.py::test_nothing_is_made_of_what_is_no_number",
        [("models in C: NaN is a number", "if (!(none == 0))", "if (none > 0)")],
    ),
    *mistakes(
        "optimal/realtime/solver.c",
        "optimal/test_agreement.py::test_an_answer_far_from_where_limits_are_missed_by_least_is_found",
        [("solver in C: where limits stay missed it goes on", "if (stays >= (settled ? 1 : STAYED))", "if (0)")],
    ),
    *mistakes(
        "optimal/realtime/solver.c",
        "control/test_usual_call.py::test_a_fallback_in_one_piece_is_the_one_put_together",
        [
            (
                "fallback in C: inputs of a step too early",
                "from[STAGE_OF(m + later < NS ? m + later : NS - 1) * NU + j]",
                "from[STAGE_OF(m) * NU + j]",
            )
        ],
    ),
    *mistakes(
        "export/c/mpc.c",
        "export/test_mpc.py::test_same_as_python_to_the_last_bit_whatever_happens",
        [
            (
                "exported MPC: a heading wound up once more",
                "s->p[i * NP + HEADING_WANTED] += angle;",
                "s->p[i * NP + HEADING_WANTED] -= angle;",
            ),
            (
                "exported MPC: a fallback that does not move on",
                "later = c->age - c->kept_age;",
                "later = 1;",
            ),
        ],
    ),
    *mistakes(
        "export/c/filter_late.c",
        "export/test_estimators.py::test_same_as_python_to_the_last_bit_whatever_it_is_given",
        [
            (
                "exported filter: a late output taken for one of now",
                "if (LATE[i] > 0)\n            f->now.seen[i] = 0;",
                "if (LATE[i] < 0)\n            f->now.seen[i] = 0;",
            )
        ],
    ),
    *mistakes(
        "export/c/filter_window.c",
        "export/test_windows.py::test_same_as_python_whatever_it_is_given",
        [
            (
                "exported window: a late output placed a sample too late",
                "int64_t k = f->samples - 1 - LATE[i];",
                "int64_t k = f->samples - LATE[i];",
            ),
            (
                "exported window: what leaves it is not moved to the next sample",
                "    predict(w->mean, w->P, &told);\n    f->samples--;",
                "    f->samples--;",
            ),
            (
                "exported window: nothing wanders",
                "at[LED + SHAKEN[j] * WIDTH + j] = WANDER[SHAKEN[j]];",
                "at[LED + SHAKEN[j] * WIDTH + j] = 0;",
            ),
        ],
    ),
    *mistakes(
        "export/c/joined.c",
        "export/test_joined.py::test_same_as_python_whatever_happens",
        [
            (
                "exported scenarios: the parts' horizons overlap",
                "((i) - LEAD) % (ONE_N + 1))",
                "((i) - LEAD) % ONE_N)",
            ),
            (
                "exported scenarios: a part that is not the likely one",
                "first = LEAD + LIKELY * (ONE_N + 1);",
                "first = LEAD;",
            ),
            (
                "exported scenarios: the state that jumps lead back to is forgotten",
                "BACK[j] >= 0 ? of->x[BACK[j]]",
                "BACK[j] >= 0 ? 0.0",
            ),
        ],
    ),
    *mistakes(
        "export/c/mpc.c",
        "export/test_joined.py::test_same_as_python_whatever_happens",
        [
            (
                "exported free duration: a plan of longer stages is followed a step later",
                "(c->age == 1 && !in_time(c))",
                "0",
            ),
        ],
    ),
    *mistakes(
        "export/c/marx_learns.c",
        "export/test_marx_learns.py::test_same_lessons_and_commands_as_python",
        [
            (
                "exported learning: what leaves the trusted region is kept",
                "    if (!trusted(theta))\n        return CAR_DOUBTFUL;\n",
                "",
            ),
            (
                "exported learning: forgets in all directions",
                "FORGETTING - (1 - FORGETTING) / information",
                "FORGETTING",
            ),
            (
                "exported learning: the program keeps its first models",
                "    if (l->lesson == CAR_LEARNED)\n        hand_over(l, s);\n",
                "",
            ),
        ],
    ),
    *mistakes(
        "export/c/switched.c",
        "export/test_switched.py::test_takes_turns_as_python_does_whatever_happens",
        [
            (
                "exported turns: the other one is not told of the plan before",
                "            car_limit_take_over(&whole(c)->limit, &limit);\n",
                "",
            ),
            (
                "exported turns: gives back at once",
                "return c->active && c->calm_steps <= DWELL;",
                "return 0;",
            ),
            (
                "exported turns: what is planned asks for no grip",
                "fabs(c->heading[i + 1] - c->heading[i]) / PERIOD * v",
                "0 * v",
            ),
        ],
    ),
    *mistakes(
        "export/c/driver.c",
        "export/test_drivers.py::test_same_as_python_to_the_last_bit_whatever_it_is_told",
        [
            (
                "exported driver: a pose for the sample after the one it counts for",
                "(car_seconds)(tick - LATE[i])",
                "(car_seconds)(tick + 1 - LATE[i])",
            ),
            (
                "exported driver: headings without what pushes the car",
                "(curvature[k] * v[k]) + push",
                "(curvature[k] * v[k])",
            ),
        ],
    ),
    *mistakes(
        "export/c/marx.c",
        "export/test_marx.py::test_same_as_python_to_the_last_bit_whatever_happens",
        [
            (
                "exported MARX-MPC: errors of the step now for those of the step before",
                "(c->work.x[o] - c->x[NS + o])",
                "(c->work.x[o] - c->x[o])",
            )
        ],
    ),
    *mistakes(
        "optimal/realtime/fallback.c",
        "control/test_usual_call.py::test_a_fallback_in_one_piece_is_the_one_put_together",
        [
            (
                "fallback in C: approached from the safe inputs",
                "(s->applied[a % NU] - s->safe[a % NU])",
                "s->safe[a % NU]",
            ),
            (
                "fallback in C: states stay where they were",
                "states_after(s->way_x, later, s->x)",
                "states_after(s->way_x, 0, s->x)",
            ),
        ],
    ),
    *mistakes(
        "control/followers/followers.py",
        (
            PLANS,
            "control/followers/test_followers.py::test_pure_pursuit_on_its_circle_steers_as_the_geometry_says",
            "control/followers/test_followers.py::test_stanley_closes_the_distance_exponentially",
        ),
        [
            (
                "pure pursuit: from the front axle",
                "x[0] - self.params.l_r * math.cos(x[2])",
                "x[0] + self.params.l_f * math.cos(x[2])",
            ),
            ("Stanley: away from the path", "math.atan2(-self.gain * e,", "math.atan2(self.gain * e,"),
        ],
    ),
    *mistakes(
        "control/followers/preview_lqr.py", PLANS, [("LQR: what the curvature does", "[-b / v - v]", "[b / v - v]")]
    ),
    *mistakes(
        "control/speed/driver.py",
        "control/speed/test_driver.py",
        [
            ("driver: the integral runs away from the limit", "back * (output - free)", "back * (free - output)"),
            (
                "driver: feedforward against the wanted acceleration",
                "+ self.feedforward * a_x",
                "- self.feedforward * a_x",
            ),
        ],
    ),
    # ---- paths, manoeuvres, sensors
    *mistakes(
        "paths/line.c",
        MEASURES,
        [
            (
                "path: distance positive to the right",
                "(Y - p[1]) * cos(p[2]) - (X - p[0]) * sin(p[2])",
                "(X - p[0]) * sin(p[2]) - (Y - p[1]) * cos(p[2])",
            ),
        ],
    ),
    *mistakes(
        "paths/path.py",
        "paths/test_line.py::test_feet",
        [
            (
                "path without a compiler: distance positive to the right",
                "float((Y - p.Y[0]) * math.cos(psi) - (X - p.X[0]) * math.sin(psi))",
                "float((X - p.X[0]) * math.sin(psi) - (Y - p.Y[0]) * math.cos(psi))",
            ),
        ],
    ),
    *mistakes(
        "paths/path.py",
        MEASURES,
        [
            ("path: edges swapped", "((self.right, -1.0), (self.left, 1.0))", "((self.right, 1.0), (self.left, -1.0))"),
            (
                "path: width of the car on one side",
                "feet[:, 1] + to_left <= lane.left",
                "feet[:, 1] - to_left <= lane.left",
            ),
        ],
    ),
    *mistakes(
        "paths/path.py",
        "paths/test_line.py::test_places",
        [("path without a compiler: turns off beyond its end", "+ beyond * np.sin(psi)", "+ beyond * np.cos(psi)")],
    ),
    *mistakes(
        "paths/line.c",
        f"{PATH}::test_open_path_goes_straight_on_beyond_its_ends",
        [("path: turns off beyond its end", "out[1] += beyond * sin(psi)", "out[1] += beyond * cos(psi)")],
    ),
    *mistakes(
        "paths/smooth.py",
        "paths/test_smooth.py::test_the_line_and_its_curvature_are_those_under_the_noise",
        [("smooth line: no price for freedom", "+ 4.0 * deviation**2 * freedom", "+ 0.0 * deviation**2 * freedom")],
    ),
    *mistakes(
        "optimal/lap/lap.py",
        "optimal/lap/test_fastest_lap.py::test_bounds_of_an_open_track_are_worth_what_laps_anew_say",
        [
            ("lap: the first point's edge is worth nothing", "at_edge.sum() + first[:1].sum()", "at_edge.sum()"),
            ("lap: the bend's centre is an edge", "curvature < INNERMOST - _AT", "curvature < np.inf"),
        ],
    ),
    *mistakes(
        "optimal/lap/course.py",
        "optimal/lap/test_fastest_lap.py::test_a_width_that_leaps_holds_on_both_sides_of_the_leap",
        [("lap: edges count at the points alone", "least[worst <= enough] = np.inf", "least[:] = np.inf")],
    ),
    *mistakes(
        "identify/judge/growth.py",
        "identify/judge/test_growth.py",
        [
            ("growth: what drifts is taken for unstable", "_GREW = 10.0", "_GREW = 3.0"),
            ("growth: any error of an unstable model is its start's", "if share > _SHARE", "if share < _SHARE"),
        ],
    ),
    *mistakes(
        "optimal/lap/course.py",
        "optimal/lap/test_fastest_lap.py::test_widths_in_another_unit_are_named",
        [("lap: any width is taken for one in m", "if width > most:", "if width > 1e9 * most:")],
    ),
    *mistakes(
        "optimal/lap/course.py",
        "optimal/lap/test_fastest_lap.py::test_widths_to_the_right_that_are_negative_are_named",
        [("lap: widths of any sign", "if found < -_BESIDE * abs(width):", "if False:")],
    ),
    *mistakes(
        "optimal/lap/cars.py",
        "optimal/lap/test_fastest_lap.py::test_what_nobody_says_of_a_car_goes_with_its_size",
        [
            (
                "lap car: what is supposed is not said",
                "for name, words in _SUPPOSED.items() if name not in known",
                "for name, words in _SUPPOSED.items() if name not in {*known, *_SUPPOSED}",
            )
        ],
    ),
    *mistakes(
        "paths/centreline.py",
        MEASURES,
        [
            (
                "path: curvature positive to the right",
                '"curvature": (dx * ddy - dy * ddx)',
                '"curvature": (dy * ddx - dx * ddy)',
            ),
            ("speed profile: half the acceleration", "v[i] * v[i] + 2 * h * free", "v[i] * v[i] + h * free"),
            ("speed profile: ellipse without its root", "math.sqrt(1.0 - used * used)", "(1.0 - used * used)"),
        ],
    ),
    *mistakes(
        "paths/lane_change.py",
        (
            f"{PATH}::test_double_lane_change_has_the_lanes_of_iso_3888_1",
            f"{PATH}::test_obstacle_avoidance_has_the_lanes_of_iso_3888_2",
            f"{PATH}::test_arc_length_heading_and_curvature_agree",
        ),
        [
            (
                "ISO 3888-1: lanes swapped",
                "1.1 * width + 0.25, 1.2 * width + 0.25, 1.3 * width + 0.25",
                "1.1 * width + 0.25, 1.3 * width + 0.25, 1.2 * width + 0.25",
            ),
            ("ISO 3888-2: second lane not beside the first", "widths, widths[0] + 1.0, width", "widths, 1.0, width"),
            ("lane change: slope of the quintic", "30 * t**2 * (1 - t) ** 2", "30 * t**2 * (1 - t)"),
            (
                "lane change: right edge on the left",
                "right[here] = (path.Y[here] - lane.right)",
                "right[here] = (lane.right - path.Y[here])",
            ),
        ],
    ),
    *mistakes(
        "data/tire_data.py",
        "data/test_tire_data.py::test_mirror_keeps_the_physics",
        [
            (
                "mirrored rig data: camber stays",
                '("slip_angle", "camber", "F_y", "M_x", "M_z")',
                '("slip_angle", "F_y", "M_x", "M_z")',
            )
        ],
    ),
    *mistakes(
        "data/readers/ttc.py",
        (
            "data/readers/test_ttc.py::test_every_sign_system_gives_the_same_data",
            "data/readers/test_ttc.py::test_signs_are_ours",
        ),
        [
            ("rig data: sign of the slip angle", "opposes = link <= 0", "opposes = link >= 0"),
            ("rig data: where z points", 'np.median(si["FZ"]) < 0', 'np.median(si["FZ"]) > 0'),
        ],
    ),
    *mistakes(
        "data/signals/excitation.py",
        "data/signals/test_excitation.py",
        [
            ("sine with dwell: at the first peak", "peak = 0.75 / frequency", "peak = 0.25 / frequency"),
            (
                "multisine: Schroeder's phases",
                "phase = -np.pi * k * (k - 1) / len(lines)",
                "phase = -np.pi * k / len(lines)",
            ),
        ],
    ),
    *mistakes(
        "models/analysis/spectral_bands.py",
        "models/analysis/test_frequency.py",
        [
            ("bands: the noise is known", "tail = float(scipy.stats.norm.sf(half))", "tail = (1 - level) / 2"),
            ("bands: deviation for variance", "square = 1 / s**2", "square = 1 / s"),
            ("bands: a phase where there is no gain", "np.where(told, np.arcsin(reach), np.pi)", "np.arcsin(reach)"),
        ],
    ),
    *mistakes(
        "data/readers/derived.py",
        "data/readers/test_csv.py",
        [("derive: a unit that is not known is SI", "if not units.known(header.unit):", "if not header.unit:")],
    ),
    *mistakes(
        "data/readers/mat5.py",
        "data/readers/test_mat5.py",
        [("MATLAB: the imaginary part is dropped", "2 if word & _COMPLEX else 1", "1")],
    ),
    *mistakes(
        "equal.py",
        "data/test_dataset.py",
        [("data are equal whatever their samples", "np.array_equal(a, b)", "True")],
    ),
    *mistakes(
        "identify/judge/standing.py",
        "identify/judge/test_standing.py",
        [("verdict: the end of what grows decides", "size.max() > _MOSTLY * size.sum()", "size.max() > size.sum()")],
    ),
    *mistakes(
        "data/headings.py",
        "data/test_headings.py",
        [
            ("heading: turns are added the wrong way", "return x - turn * turns", "return x + turn * turns"),
            ("heading: in degrees, unwrapped by radians", "np.diff(x) / turn", "np.diff(x) / TURN"),
        ],
    ),
    *mistakes(
        "control/racing/racer.py",
        "control/racing/test_racer.py::test_a_wheel_that_spins_is_not_learned_as_a_weak_engine",
        [
            ("racer: a wheel that spins is a weak engine", "0.0 if spinning else throttle", "throttle"),
            ("racer: any weak engine is a wheel that spins", "believed > self._spins and share", "share"),
        ],
    ),
    *mistakes(
        "control/racing/on_road.py",
        "control/racing/test_along_track.py",
        [("racer: a stiff car in two steps", "dt * quickest / STABLE", "0.0")],
    ),
    *mistakes(
        "simulate/race.py",
        "simulate/test_race_start.py",
        [
            ("race: starts in a bend", "turning <= CALM * turning.max()", "turning <= turning.max()"),
            ("race: starts where it brakes", "(lap.F_x[:-2] >= 0.0)", "(lap.F_x[:-2] > -np.inf)"),
        ],
    ),
    *mistakes(
        "data/holds.py",
        "data/test_holds.py",
        [
            ("means: a moving input smoothed by its hold", "x + curved / 6 + _curved(curved) / 30", "x"),
            ("means: a pedal less than released", ", *_rests(x))", ", -np.inf, np.inf)"),
            (
                "means: the moving input stays sharpened",
                "scipy.sparse.eye_array(n) + curved / 6",
                "scipy.sparse.eye_array(n) + 0",
            ),
        ],
    ),
    *mistakes(
        "data/dataset.py",
        "data/test_dataset.py::test_detrend_uses_training_offsets_on_test_data",
        [("detrend: adds the mean", "self.index(name)] -= value", "self.index(name)] += value")],
    ),
    *mistakes(
        "simulate/loop.py",
        "simulate/test_loop.py::test_the_run_holds_what_happened",
        [("drive: sign of the heading error", "remainder(psi - foot.psi", "remainder(foot.psi - psi")],
    ),
    *mistakes(
        "simulate/run.py",
        "simulate/test_loop.py::test_width_decides_whether_it_was_inside",
        [("drive: width of the car on one side", "self.e_y + half <= lane.left", "self.e_y - half <= lane.left")],
    ),
    *mistakes(
        "data/quality/lateness.py",
        "data/quality/test_lateness.py",
        [
            ("lateness: sign of the steering's rate", "columns = [-v * rate,", "columns = [v * rate,"),
            ("lateness: lag of the tires forgotten", "[-v * v * rate] if by_speed", "[] if by_speed"),
            ("lateness: a_y as early as r", "Lag(-across.seconds, across.error)", "Lag(across.seconds, across.error)"),
            ("lateness: jerk the wrong way", "lag - drives.dt) -", "lag + drives.dt) -"),
            ("lateness: any speed is told late", "_BEHIND = 0.1, 3.0", "_BEHIND = 0.5, 3.0"),
        ],
    ),
    *mistakes(
        "data/quality/speed_scale.py",
        "data/quality/test_lateness.py",
        [
            ("speed scale: upside down", "found[0] / found[1]", "found[1] / found[0]"),
            ("speed scale: by plain least squares", "first @ total[:told, -1]", "first @ total[:told, told]"),
        ],
    ),
    *mistakes(
        "data/quality/clipped.py",
        "data/quality/test_clipped.py",
        [
            ("clipped: one side only", "for side in (1.0, -1.0)}", "for side in (1.0, 1.0)}"),
            ("clipped: a rest that begins at its most", "or first - end > _AT_ONCE * more", "or False"),
        ],
    ),
    *mistakes(
        "optimal/realtime/last_steps.py",
        "optimal/test_last_steps.py",
        [
            ("last steps: never slow", "return math.log(tolerance", "return 0 * math.log(tolerance"),
            ("last steps: a dearer plan is taken", "return found and other <= cost", "return found or other <= cost"),
            (
                "last steps: a plan as none",
                "return status.unfinished and violation",
                "return not status.unfinished and violation",
            ),
        ],
    ),
    *mistakes(
        "export/kinds.py",
        "export/test_mpc.py::test_plans_that_gauss_newton_steps_do_not_end_are_recorded_as_the_code_makes_them",
        [("export: recorded with the last steps", "_driven(as_in_c(thing), drive)", "_driven(thing, drive)")],
    ),
    *mistakes(
        "simulate/sensors.py",
        "simulate/test_sensors.py",
        [
            ("sensor: cuts off instead of rounding", "np.round(shown / s.quantum)", "np.floor(shown / s.quantum)"),
            ("sensor: gain the wrong way", "(1.0 + s.gain) * values", "(1.0 - s.gain) * values"),
            (
                "sensor: drift grows with time, not its root",
                "s.drift * math.sqrt(self.every * self._dt)",
                "s.drift * self.every * self._dt",
            ),
            ("sensor: shows before the delay", "+ k * self.every + self.late", "+ k * self.every"),
        ],
    ),
    *mistakes(
        "simulate/loop.c",
        "export/test_built.py::test_a_loop_without_python_has_the_same_numbers",
        [
            (
                "compiled loop: delay a step short",
                "most - l->late[j] + k;",
                "most - l->late[j] + k + (l->late[j] > 0);",
            ),
            (
                "compiled loop: sample shown a step late",
                "s->arrivals[s->first] <= tick",
                "s->arrivals[s->first] < tick",
            ),
            ("compiled loop: no lag", "l->share[j] < 1 ?", "l->share[j] < 0 ?"),
        ],
    ),
]
