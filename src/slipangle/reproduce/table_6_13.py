"""Table 6.13: lateral errors reported in the literature, and those of tables 6.5, 6.6, 6.11 and 6.12.

The ranges of other authors are as the thesis prints them, on their own vehicles, paths and speeds (references 68, 133,
27 and 134 there); they are shown, not judged. Ours span the rows with Pacejka tires of the four tables, driven by
real-time iterations as described there, each judged against the thesis' range.
"""

from slipangle import RealTime, double_lane_change, lane_changes
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_2, SOUSA_TABLE_6_8
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._chapter_6 import FRONT_DRIVE, HORIZONS, REAR_DRIVE, LookUpTire, drive
from slipangle.reproduce._cvodes import ByCvodes
from slipangle.reproduce._tires_6 import look_up_tire

PRINTED = {
    "[68] MPC": ("-", "0.40 - 0.50"),
    "[133] MPC": ("0.20 - 0.60", "0.76 - 1.76"),
    "[27] game theory": ("-", "0.46 - 0.71"),
    "[134] MPC": ("0.031 - 0.142", "0.40 - 0.47"),
}


def reproduce(progress: Progress) -> Reproduction:
    """Drive the rows with Pacejka tires."""
    tables: LookUpTire = look_up_tire()
    cases = [
        (FRONT_DRIVE, SOUSA_TABLE_6_2, SOUSA_TABLE_6_2, double_lane_change(20.0, blend=12.0)),
        (FRONT_DRIVE, SOUSA_TABLE_6_2, SOUSA_TABLE_6_2, lane_changes(20.0, change=50.0)),
        (REAR_DRIVE, SOUSA_TABLE_6_8, tables, double_lane_change(25.0, width=1.4, blend=12.0)),
        (REAR_DRIVE, SOUSA_TABLE_6_8, tables, lane_changes(25.0, change=50.0)),
    ]
    drives = []
    for k, (car, predicted, real, path) in enumerate(cases):
        plant = ByCvodes(car.model(real))
        for horizon in HORIZONS:
            progress((k + horizon / 20) / len(cases), f"{path.name}, N = {horizon}")
            drives.append(drive(plant, car.controller(car.model(predicted), horizon, RealTime()), car, path))
    quantities = "lateral RMSE [m]", "largest lateral error [m]"
    records = [
        Record(name, quantity, value, "-", note="as printed in the thesis")
        for name, values in PRINTED.items()
        for quantity, value in zip(quantities, values, strict=True)
    ]
    note = "the thesis' paths are not given: ISO 3888-1 lanes, and lane changes over 50 m"
    ours = ([d.rmse for d in drives], "0.15 - 0.32", 0.32), ([d.largest for d in drives], "0.36 - 0.73", 0.73)
    for quantity, (values, printed, most) in zip(quantities, ours, strict=True):
        here = f"{min(values):.4f} - {max(values):.4f}"
        records.append(Record("proposed", quantity, printed, here, f"<= {most:g}", max(values) <= most, note))
    return Reproduction.told(__doc__, records)
