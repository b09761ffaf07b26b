"""Whatever is public can be named in a job, or it stands here why not; and what is named drives and fits."""

import inspect
import json
import re
from pathlib import Path

import numpy as np
import pytest

import slipangle as sa
from slipangle.cli import main
from slipangle.errors import ConfigError
from slipangle.workflow.drive import CONTROLLERS, ESTIMATORS, PLANTS
from slipangle.workflow.entries import Made
from slipangle.workflow.kinds import FITS, KINDS, Adapted, as_physics
from slipangle.workflow.reference import records_in, tables
from slipangle.workflow.settings import read_settings
from tests.workflow.test_cli import write_job
from tests.workflow.test_jobs import noisy

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler was found")  # jobs run without one too

FROM_KEYS = {  # made where a key or another one asks for them
    sa.Column: "[data.columns]",
    sa.Weights: "Q, S and so on",
    sa.Limits: "plausible and so on",
    sa.Values: "safe and so on",
    sa.Delayed: "free = ['delay_delta']",
    sa.Steered: "free = ['steering_lag']",
    sa.Banked: "banked = true",
    sa.LoadTransfer: "free = ['height']",
    sa.RearSteered: "rear_steered = true",
    sa.TorqueVectored: "torque_vectored = true",
    sa.OnGround: "every controller poses its model",
    sa.Disturbed: "kind = 'driver' has it inside",
    sa.Lagging: "kind = 'driver' has it inside",
    sa.SingleTrack: "[plant]",
    sa.Plant: "[plant]",
    sa.SpeedDriver: "[plant] brings its own",
    sa.Path: "manoeuvre",
    sa.OCP: "kind = 'mpc' has it inside",
    sa.BicycleParams: "car",
    sa.LongitudinalParams: "car",
    sa.NonlinearBicycleParams: "car",
    sa.SaturatingBicycleParams: "car",
    sa.SingleTrackParams: "catalogue",
    sa.TireBicycle: "kind = 'tire-bicycle' fits one",
    sa.TireBicycleParams: "car of that",
    sa.MagicFormulaTire: "tire = 'FILE.tir'",
    sa.DualTrack: "[plant] with tires of files",
    sa.ARXModel: "kind = 'arx' gives one, 'saved' reads one",
    sa.NARXModel: "kind = 'narx' gives one, 'saved' reads one",
    sa.MultiARXModel: "kind = 'multi-arx' gives one, 'saved' reads one",
    sa.Adapt: "kind = 'adapt'",
    sa.Compensated: "kind = 'driver' with law = 'stanley'",
}
NEVER = {  # no setting, or nothing that a file can say
    sa.Dataset: "the log",
    sa.Channel: "a part of it",
    sa.Recording: "a log before it is one",
    sa.Model: "what all models are",
    sa.Tire: "what all tires are",
    sa.FitInfo: "a result",
    sa.IdentifiedCar: "a result",
    sa.Trajectory: "a result",
    sa.Validation: "a result",
    sa.Run: "a result",
    sa.Reference: "computed at every step",
    sa.Ode: "equations in Python; a package registers its own model",
    sa.PlantFunctions: "functions in Python; a package registers its own plant",
    sa.LinearTire: "a part of a model in Python",
    sa.SimpleMagicFormula: "a part of a model in Python",
    sa.MagicCurve: "a part of that",
    sa.SideSlipSensor: "learned in Python; what it says is a measured channel",
    sa.LapCar: "made of a model and what it does not know, see `slipangle lap`",
    sa.TerminalCost: "a term of a problem in Python",
    sa.Scenarios: "of a problem in Python",
    sa.Lap: "a result",
    sa.DrivenLap: "a result",
    sa.LapDelta: "a result",
    sa.PhasedPlan: "a result",
    sa.Phases: "problems in Python, one behind the other",
    sa.LookupTable: "a part of equations in Python",
    sa.Racer: "races in Python, on a lap",
    sa.Pedals: "a part of that",
}  # fmt: skip


def reachable():
    """Classes that a table of a job makes."""
    for thing in (*KINDS.values(), *FITS.values(), *CONTROLLERS.values(), *ESTIMATORS.values(), *PLANTS.values()):
        physics = as_physics(thing)
        if physics is not None:
            yield physics.model
        elif isinstance(thing, Made):
            yield thing.of
        else:
            yield thing if inspect.isclass(thing) else inspect.signature(thing).return_annotation
    for table in tables().values():
        for key in table.keys:
            yield from records_in(key.entry.hint)


def test_every_public_class_can_be_named_or_it_is_said_why_not():
    named = set(reachable())
    public = {c for c in (getattr(sa, n) for n in sa.__all__) if inspect.isclass(c)}
    assert {c.__name__ for c in public - named - FROM_KEYS.keys() - NEVER.keys()} == set()
    assert {c.__name__ for c in NEVER.keys() & named} == set()


MODELS = {
    "kinematic": "kind = 'kinematic'\ncar = { wheelbase = 2.6, l_f = 1.2, mass = 1200, inertia_z = 1500 }",
    "saturating": "kind = 'saturating-bicycle'\nfree = ['C_f']\nfit = { max_iterations = 5, starts = 1 }",
    "steered": "kind = 'bicycle'\nfree = ['C_f', 'steering_lag']",
    "ekf": "kind = 'bicycle'\nfree = ['C_f']\nfit = { kind = 'ekf', noise_std = { r = 0.01 }, gate = 9 }",
    "collocation": "kind = 'bicycle'\nfree = ['C_f']\nfit = { kind = 'collocation', max_iterations = 30 }",
    "rls": "kind = 'rls'\nna = 2\nnb = 2",
    "subspace": "kind = 'subspace'\norder = 2",
    "polynomial": "kind = 'polynomial'\nna = 2\nnb = 2\nnc = 1\nnd = 0",
}
_CAR = "car = { mass = 1200, wheelbase = 2.6, l_f = 1.2, inertia_z = 1500, C_f = 8e4, C_r = 9e4 }\n"


@pytest.mark.parametrize("name", MODELS)
def test_models_and_ways_of_fitting(name, tmp_path, capsys):
    entries = MODELS[name]
    car = _CAR if "bicycle" in entries else ""
    inputs = ["delta", "v_x"] if car or name == "kinematic" else ["delta"]
    more = f"[[model]]\nname = 'x'\n{entries}\n{car}outputs = ['r']\ninputs = {inputs}"
    job = write_job(tmp_path, rows=noisy(240), more=more)
    main(["identify", str(job), "--out", str(tmp_path / "out"), "--json"])
    found = json.loads(capsys.readouterr().out)
    assert "failure" not in found["x"], found["x"]
    assert (tmp_path / "out" / "x.json").exists()


def test_models_made_of_others(tmp_path, capsys):
    """A saved model, found beside the job from anywhere, adapted to this log; a refinement of a state space."""
    more = "[[model]]\nname = 's'\nkind = 'subspace'\norder = 2\ninputs = ['delta']\n"
    job = write_job(tmp_path, rows=noisy(300), more=more)
    assert main(["identify", str(job), "--out", str(tmp_path), "--json"]) == 0
    more += "[[model]]\nname = 'old'\nkind = 'saved'\nfile = 'bicycle.json'\n"
    more += "[[model]]\nname = 'new'\nkind = 'adapt'\nmodel = 'old'\nsettings = { seconds = 8, folds = 2 }\n"
    more += "[[model]]\nname = 'p'\nkind = 'pem'\nstart = 's'\ninputs = ['delta']\n"
    capsys.readouterr()
    assert main(["identify", str(write_job(tmp_path, rows=noisy(300), more=more)), "--out", str(tmp_path / "o")]) == 0
    said = capsys.readouterr().out
    assert "failed" not in said
    kept = sa.load(tmp_path / "o" / "old.json")
    assert kept == sa.load(tmp_path / "bicycle.json")
    assert sa.load(tmp_path / "o" / "new.json").model == kept
    assert Adapted.__dataclass_fields__.keys() == {"model", "train", "settings"}


def test_a_model_made_of_one_below_it(tmp_path, capsys):
    """Their order in the job is that of what is shown, not of the work."""
    above = "[[model]]\nname = 'p'\nkind = 'pem'\nstart = 's'\ninputs = ['delta']\n"
    below = "[[model]]\nname = 's'\nkind = 'subspace'\norder = 2\ninputs = ['delta']\n"
    found = []
    for i, more in enumerate((above + below, below + above)):
        out = tmp_path / str(i)
        job = write_job(tmp_path, rows=noisy(300), more=more)
        assert main(["identify", str(job), "--out", str(out), "--json"]) == 0
        found.append((list(json.loads(capsys.readouterr().out)), sa.load(out / "p.json")))
    (one, first), (other, second) = found
    assert (one[-2:], other[-2:]) == (["p", "s"], ["s", "p"])
    assert np.array_equal(first.A, second.A)


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (
            "model = 'y'\n[[model]]\nname = 'y'\nkind = 'adapt'\nmodel = 'x'",
            "model 'x' needs 'y' needs 'x'; expected one to begin with",
        ),
        ("model = 'x'", "model 'x' needs 'x'; expected one to begin with"),
        ("model = 'bicicle'", "needs 'bicicle', which the job has not; nearest are 'bicycle'"),
        ("", "lacks the entry 'model'"),
    ],
)
def test_a_model_that_is_not_there(model, said, tmp_path, capsys):
    job = write_job(tmp_path, more=f"[[model]]\nname = 'x'\nkind = 'adapt'\n{model}")
    assert main(["identify", str(job), "--out", str(tmp_path / "o")]) == 2
    assert said in capsys.readouterr().err


def test_a_model_of_another_class_and_one_that_failed_cost_the_others_nothing(tmp_path, capsys):
    more = "[[model]]\nname = 'a'\nkind = 'arx'\nna = 900\nnb = 900\n"
    more += "[[model]]\nname = 'x'\nkind = 'adapt'\nmodel = 'a'\n[[model]]\nname = 'y'\nkind = 'pem'\nstart = 'bicycle'"
    assert main(["identify", str(write_job(tmp_path, more=more)), "--out", str(tmp_path / "o"), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert "the model 'a', which 'x' needs, could not be fitted" in found["x"]["failure"]
    assert "start of 'y' is 'bicycle', a Bicycle; expected a StateSpaceModel" in found["y"]["failure"]
    assert found["bicycle"]["parameters"]


# ---- closed loops --------------------------------------------------------------------------------------------------

DRIVES = {
    "pure-pursuit": "",
    "stanley": "gain = 2.0",
    "feedforward-feedback": "lead = 0.02",
    "preview-lqr": "weight_y = 2.0",
    "mpc": "solver = { kind = 'real-time', iterations = 2 }\nR = { delta = 0.1 }\ndeadline = 1.0",
    "driver": "noise = { r = 0.003 }\ndt = 0.02",
    "driver, by a law": "noise = { r = 0.003 }\ndt = 0.02\nlaw = 'stanley'",
}


def drive(tmp_path: Path, capsys, controller: str) -> dict:
    free = "free = ['C_f']\n"
    job = write_job(tmp_path, more=f"{free}[controller]\nmodel = 'bicycle'\nv_x = 10.0\ncars = 0\n{controller}")
    assert main(["run", str(job), "--out", str(tmp_path / "out"), "--json"]) == 0
    return json.loads(capsys.readouterr().out)["closed_loop"]


@pytest.mark.parametrize("kind", DRIVES)
def test_controllers(kind, tmp_path, capsys):
    seen = drive(tmp_path, capsys, f"kind = '{kind.partition(',')[0]}'\n{DRIVES[kind]}")
    assert seen["end"] == "FINISHED"
    assert seen["max_y"] < 1.5


def test_a_track_is_driven_from_a_file_beside_the_job(tmp_path, capsys):
    s = np.linspace(0, 200, 60)
    rows = [f"{x:.2f},{10 * np.sin(x / 60):.3f},4,4" for x in s]
    (tmp_path / "track.csv").write_text("\n".join(["# x_m,y_m,w_tr_right_m,w_tr_left_m", *rows]))
    seen = drive(tmp_path, capsys, "track = 'track.csv'\nkind = 'stanley'\na_y = 2.0")
    assert (seen["end"], seen["inside_lane"]) == ("FINISHED", True)
    page = (tmp_path / "out" / "index.html").read_text().replace("\N{NO-BREAK SPACE}", " ")
    assert "Edges and the line to follow are those of the track." in page
    assert "the standard" not in page
    said = re.search(r"solver, 99th percentile</dt><dd[^>]*>([\d.]+)", page)
    assert said, "the page says the solver's time"
    assert float(said[1]) == pytest.approx(1000 * seen["solver_seconds_p99"], rel=0.01)


@pytest.mark.parametrize("kind", ["ekf", "mhe"])
def test_an_estimator_in_the_loop(tmp_path, capsys, kind):
    """With a filter the loop needs no measurement of every output of the model; it drives about as well."""
    noise = "[plant]\nnoise = { X = 0.05, Y = 0.05, r = 0.01 }\n"
    plain = drive(tmp_path, capsys, noise)
    filtered = drive(
        tmp_path,
        capsys,
        noise
        + f"[estimator]\nkind = '{kind}'\n"
        + "noise_std = { X = 0.05, Y = 0.05, psi = 0.002, v_y = 0.02, r = 0.01 }\n"
        "process_std = { v_y = 0.1, r = 0.1 }\ngate = 8",
    )
    assert filtered["end"] == plain["end"] == "FINISHED"
    assert filtered["rmse_y"] < plain["rmse_y"] + 0.1
    assert filtered != plain


def test_kinds_that_do_not_suit_get_a_sentence(tmp_path, capsys):
    for more, said in {
        "kind = 'stanly'": "kind is 'stanly'; nearest are 'stanley'",
        "kind = 'stanley'\nhorizn = 3": "no entry 'horizn'; nearest are 'horizon'",
        "[estimator]\nkind = 'ekff'": "estimator: kind is 'ekff'; nearest are 'ekf'",
        "[estimator]\ngates = 3": "no entry 'gates'; nearest are 'gate'",
    }.items():
        job = write_job(tmp_path, more=f"[controller]\nmodel = 'bicycle'\n{more}")
        assert main(["run", str(job), "--out", str(tmp_path / "out")]) == 2
        assert said in capsys.readouterr().err
    job = write_job(tmp_path, more="[plant]\ncatalogue = 'bmw-320i'")
    with pytest.raises(ConfigError, match=r"\[plant\] catalogue is 'bmw-320i'; .*'sousa-table-6.1'"):
        read_settings(job)
    black = "[[model]]\nname = 'a'\nkind = 'arx'\nna = 2\nnb = 2\n[controller]\nmodel = 'a'\n"
    for more, said in {
        "": "has no catalogue name and the controller's model is no bicycle",
        "[plant]\ntire = 'a.tir'": "has tires and no car to put them on",
        "kind = 'stanley'\n[plant]\ncatalogue = 'sousa-table-6.1'": "needs mass, geometry and cornering stiffness",
        "kind = 'driver'\nlaw = 'stanley'\n[plant]\ncatalogue = 'sousa-table-6.1'": "needs mass, geometry",
    }.items():
        with pytest.raises(ConfigError, match=said):  # no file is read, and nothing is fitted
            read_settings(write_job(tmp_path, more=black + more))
    read_settings(write_job(tmp_path, more=f"{black}[plant]\ncatalogue = 'sousa-table-6.1'"))
    arx = "[[model]]\nname = 'a'\nkind = 'arx'\nna = 2\nnb = 2\n[controller]\nmodel = 'a'\nkind = 'stanley'"
    arx += "\n[plant]\ncatalogue = 'sousa-table-6.1'"
    assert main(["run", str(write_job(tmp_path, rows=noisy(240), more=arx)), "--out", str(tmp_path / "out")]) == 2
    assert "needs mass, geometry and cornering stiffness, and the model 'a' has none" in capsys.readouterr().err
