"""Table 7.4: one ARX model and its controller at 10, 15 and 20 m/s.

Plant, logs and models as in table 7.1; controllers with table 7.3 (N = 10, 0.05 s, Q = 100, +-20 deg). Its S = 100 is
taken to count the steering wheel's angle with a ratio of 10, as the angles of chapter 6 do. The path of fig. 7.6 is not
given: here the waves of segments 1 and 2 of sec. 7.2.2, at one speed. Errors are distances from the path; R2 compares
the car's Y with the path's at the car's nearest point. Plans are solved by the compiled quadratic program.
"""

import numpy as np

from slipangle import Channel, MultiARXModel
from slipangle.report.drives import Signal, signals
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._chapter_7 import LIMIT, SPEEDS, blended, drive, sine_log
from slipangle.reproduce.table_7_1 import choose, search
from slipangle.simulate.manoeuvres import three_segments

PRINTED = {10.0: (0.9987, 0.1560), 15.0: (0.9985, 0.1680), 20.0: (0.9982, 0.1795)}


def reproduce(progress: Progress) -> Reproduction:
    """Identify, control, drive at each speed."""
    records, figures = [], []
    for k, v in enumerate(SPEEDS):
        progress(k / len(SPEEDS), f"{v:g} m/s")
        model = choose(search(sine_log(v))).model
        controller = blended(MultiARXModel(models=(model,), speeds=(v,)))
        run = drive(controller, three_segments(speeds=(v, v, v), amplitudes=(5.0, 1.5, 1e-3)))
        Y, wanted = run["Y"], run.reference[:, 1]
        r2 = 1 - float(np.sum((Y - wanted) ** 2) / np.sum((wanted - wanted.mean()) ** 2))
        steered = float(np.rad2deg(np.abs(run.commands).max()))
        row, most = f"ARX-MPC-{v:g}", float(np.rad2deg(LIMIT))
        note = f"{run.end.value}; plan {1e6 * float(np.median(run.seconds)):.0f} us in Python, wall"
        records += [
            Record.judged(row, "R2 [-]", PRINTED[v][0], r2, at_least=0.998),
            Record.judged(row, "RMSE [m]", PRINTED[v][1], run.rmse("y"), at_most=PRINTED[v][1], note=note),
            Record(row, "largest steering angle [deg]", None, steered, f"<= {most:g}", steered <= most + 1e-10),
        ]
        path = Signal(channel=Channel("Y", "m"), values=Y, reference=wanted)
        steering = Signal(channel=Channel("delta", "rad"), values=run["delta"], lower=-LIMIT, upper=LIMIT)
        figures.append(signals(run.t, [path, steering]))
    captions = [f"ARX-MPC-{v:g}: path and steering at {v:g} m/s" for v in PRINTED]
    return Reproduction.told(__doc__, records, figures, captions)
