"""Files of models: the same bits back, and one sentence for every way a file can be wrong."""

import json
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass, replace

import casadi as ca
import numpy as np
import pytest

from slipangle.data.readers.column import Column
from slipangle.errors import FormatError, MissingFileError, ModelWarning, ParameterError, SlipangleError, WriteError
from slipangle.identify.linear.arx import ARX
from slipangle.models import storage
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.black_box.networks import MLP, RBF
from slipangle.models.model import FitInfo, Model, Trial
from slipangle.models.ode import OdeModel
from slipangle.models.storage import fits, load, save
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
from slipangle.models.tires.neural import NeuralCurve, NeuralTire
from slipangle.models.tires.on_road import OnRoad
from slipangle.models.tires.physical import BrushTire, DugoffTire
from slipangle.models.tires.simple import LinearTire, Tire
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_2, SOUSA_TABLE_7_2
from slipangle.models.vehicles.parameters import BicycleParams
from slipangle.paths.lane_change import double_lane_change
from slipangle.reproduce.plants import narendra
from tests.models.all_models import ALL_MODELS, typical
from tests.models.test_contracts import record
from tests.models.tires.example_tires import TIRES

EVERY = pytest.mark.parametrize("model", ALL_MODELS.values(), ids=ALL_MODELS.keys())
NEAT = FitInfo(
    names=("C_f",),
    values=np.array([6e4]),
    covariance=np.array([[np.nan]]),
    noise_std=np.array([0.1]),
    n_samples=7,
    trials=(
        Trial(seed=3, score=np.inf, epoch=0, epochs=20, seconds=0.1, curve=np.array([[0, np.inf], [20, -0.0]])),
        Trial(seed=4, score=0.25, epoch=20, epochs=20, seconds=0.1, curve=np.empty((0, 2)), note='"ü"\n'),
    ),
)


def same(a, b):
    """Equal classes, equal bits, all the way down."""
    if is_dataclass(a):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and (a.shape, a.dtype, a.tobytes()) == (b.shape, b.dtype, b.tobytes())
    if isinstance(a, tuple):
        return type(a) is type(b) and len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and (a == b or (a != a and b != b))


@EVERY
def test_round_trip_to_the_bit(model, tmp_path):
    back = load(save(model, tmp_path / "model.json"))
    assert same(model, back)
    x, u = typical(model, 5)
    assert np.array_equal(model.step(x, u), back.step(x, u))
    data = record(model)
    assert np.array_equal(model.simulate(data).y, back.simulate(data).y)


@pytest.mark.parametrize(
    "thing",
    [
        SOUSA_TABLE_7_2,
        SOUSA_TABLE_6_2,
        LinearTire(C_alpha=1 / 3),
        MLP.random((2, 3, 1), seed=1),
        RBF(centres=[[0.1]], widths=[2.0], weights=[[1e-320]]),
        NEAT,
    ],
    ids=lambda thing: type(thing).__name__,
)
def test_other_records(thing, tmp_path):
    assert same(thing, load(save(thing, tmp_path / "thing.json")))


def examples_of_tires():
    curve = NeuralCurve(network=MLP.random((2, 3, 1), seed=2), inputs=("slip", "load"))
    return [
        LinearTire(C_alpha=1 / 3),
        SOUSA_TABLE_6_2,
        BrushTire(C_alpha=6e4, C_s=1e5),
        DugoffTire(C_alpha=6e4, C_s=1e5, mu=0.9),
        NeuralTire(longitudinal=curve, lateral=curve, combined="ellipse"),
        *TIRES.values(),
        MagicFormulaTire.from_tir(TIRES["6.1"].to_tir()),
        OnRoad(tire=SOUSA_TABLE_6_2, friction=0.6),
    ]


@pytest.mark.parametrize("tire", examples_of_tires(), ids=lambda tire: type(tire).__name__)
def test_tires_give_the_same_forces(tire, tmp_path):
    back = load(save(tire, tmp_path / "tire.json"))
    assert same(tire, back)
    assert tuple(tire.forces(0.03, 0.05, 4000.0)) == tuple(back.forces(0.03, 0.05, 4000.0))


def test_every_class_of_tire_and_model_is_among_the_examples():
    """So that a new one cannot be forgotten."""
    examples = (*examples_of_tires(), *ALL_MODELS.values())
    known = {c for c in storage._known(()).values() if issubclass(c, (Tire, Model))}
    assert known <= {type(e) for e in examples}


def test_fit_info_travels_with_the_model(tmp_path):
    model = ARX(na=2, nb=2).fit(narendra.estimation(200))
    back = load(save(model, tmp_path / "arx.json"))
    assert same(model.fit_info, back.fit_info)
    assert np.array_equal(back.fit_info.std, model.fit_info.std)


def test_a_fit_of_other_parameters_is_left_out(tmp_path):
    """Changed by hand in the file, the intervals would be those of another car."""
    model = ALL_MODELS["bicycle"]
    names = model.parameter_names[:3]
    values = np.array([model.value(n) for n in names])
    info = replace(NEAT, names=names, values=values, covariance=np.eye(3))
    path = save(replace(model, fit_info=info), tmp_path / "car.json")
    assert load(path).fit_info is not None
    text = path.read_text(encoding="utf-8")
    first = f'"{names[0]}": {float(values[0])!r}'
    assert text.count(first) == 1
    path.write_text(text.replace(first, f'"{names[0]}": {1.01 * float(values[0])!r}'), encoding="utf-8")
    with pytest.warns(ModelWarning, match=rf"car.json' {names[0]} is .*, where its fit found .* left out"):
        changed = load(path)
    assert changed.fit_info is None
    assert changed.value(names[0]) == 1.01 * float(values[0])


def test_random_bits_survive(tmp_path):
    """Any finite double, denormals and signed zeros included."""
    rng = np.random.default_rng(0)
    bits = rng.integers(0, 2**64, 4000, dtype=np.uint64).view(float)
    values = np.concatenate([bits, [0.0, -0.0, 5e-324, -5e-324, 1.7976931348623157e308, np.nan, np.inf, -np.inf]])
    values[np.isnan(values)] = np.nan
    info = replace(NEAT, values=values)
    assert same(info, load(save(info, tmp_path / "bits.json")))


def test_file_is_readable_json(tmp_path):
    path = save(ALL_MODELS["ARX"], tmp_path / "arx.json")
    text = path.read_text()
    content = json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))
    assert content["record"]["class"] == "ARXModel"
    assert content["record"]["fields"]["A"]["array"] == [[[-1.5]], [[0.7]]]
    assert max(map(len, text.splitlines())) < 200
    save(NEAT, path)
    json.loads(path.read_text(), parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))


def test_failed_save_leaves_the_old_file(tmp_path):
    path = save(ALL_MODELS["ARX"], tmp_path / "arx.json")
    before = path.read_bytes()
    symbolic = SOUSA_TABLE_7_2.with_values(C_f=ca.SX.sym("C_f"))
    with pytest.raises(ParameterError, match=r"BicycleParams\.C_f holds a symbol"):
        save(symbolic, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["arx.json"]


@dataclass(frozen=True, kw_only=True)
class Spinner(OdeModel):
    """A user's own model."""

    states = ("phi", "omega")
    inputs = ("M",)

    def derivative(self, x, u):
        return np.array([x[1], u[0] - self.params.mass * x[0]])


def test_own_classes_are_named_on_both_sides(tmp_path):
    own = Spinner(params=SOUSA_TABLE_7_2, dt=0.1)
    with pytest.raises(ParameterError, match=r"Spinner.*classes"):
        save(own, tmp_path / "own.json")
    path = save(own, tmp_path / "own.json", classes=[Spinner])
    assert same(own, load(path, classes=[Spinner]))
    with pytest.raises(FormatError, match=r"unknown class 'Spinner'.*classes"):
        load(path)


@pytest.mark.parametrize("thing", [3.0, BicycleParams, {"a": 1}, double_lane_change(20.0), Column("yaw rate")])
def test_only_records_are_saved(thing, tmp_path):
    with pytest.raises(ParameterError, match=r"expected a model, tire or parameter set"):
        save(thing, tmp_path / "thing.json")


def test_place_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError):
        save(ALL_MODELS["ARX"], tmp_path / "file" / "arx.json")


# ---- wrong files ---------------------------------------------------------------------------------------------------


def changed(tmp_path, change, model="ARX"):
    path = save(ALL_MODELS[model], tmp_path / "model.json")
    content = json.loads(path.read_text())
    change(content, content["record"]["fields"])
    path.write_text(json.dumps(content))
    return path


def test_missing_file(tmp_path):
    with pytest.raises(MissingFileError, match=r"nothing\.json"):
        load(tmp_path / "nothing.json")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "not JSON"),
        ('{"format": "slipangle rec', "not JSON"),
        ("[1, 2]", "slipangle record"),
        ('{"format": "other"}', "slipangle record"),
        ('{"format": "slipangle record", "version": NaN}', "NaN"),
        ('{"format": "slipangle record", "version": 1}', "holds no record"),
        ('{"format": "slipangle record", "version": 1, "record": {"map": {}}}', "holds no record"),
        ('{"format": "slipangle record", "version": 1, "record": ' + "[" * 900 + "]" * 900 + "}", "nested"),
        ("[" * 100_000, "not JSON"),
        ('{"format": "slipangle record", "version": 1, "record": {"float": {}}}', "has the keys"),
        ('{"format": "slipangle record", "version": 1, "record": {"array": [], "dtype": []}}', "is an array of"),
    ],
)
def test_not_a_saved_file(tmp_path, text, said):
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(FormatError, match=said):
        load(path)


def test_not_even_text(tmp_path):
    path = tmp_path / "x.json"
    path.write_bytes(b"PK\x03\x04\xff\xfe")
    with pytest.raises(FormatError, match="not text"):
        load(path)


@pytest.mark.parametrize("version", [0, 2, "1", None, True, 1.5])
def test_other_version(tmp_path, version):
    path = changed(tmp_path, lambda content, _: content.update(version=version))
    with pytest.raises(FormatError, match=r"version .* \(written by slipangle .*\), this slipangle reads version 1"):
        load(path)


def test_missing_and_unknown_fields(tmp_path):
    with pytest.raises(FormatError, match=r"ARXModel .* lacks the field 'dt'"):
        load(changed(tmp_path, lambda _, f: f.pop("dt")))
    with pytest.raises(FormatError, match="unknown field 'outputz'; nearest are 'outputs'"):
        load(changed(tmp_path, lambda _, f: f.update(outputz=1)))
    with pytest.raises(FormatError, match="unknown class 'ARXModle'; nearest are 'ARXModel'"):
        load(changed(tmp_path, lambda content, _: content["record"].update({"class": "ARXModle"})))
    with pytest.raises(FormatError, match=r"unknown class \['os'\]"):
        load(changed(tmp_path, lambda content, _: content["record"].update({"class": ["os"]})))


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("dt", "0.05", r"ARXModel.dt .* is '0.05'; expected float"),
        ("nk", 1.5, "expected int"),
        ("nk", -1, "nk is -1"),
        ("inputs", ["delta", 3], r"expected tuple\[str"),
        ("A", [1.0], "ndarray"),
        ("A", {"array": [[1.0], [1.0, 2.0]]}, "rows of one length"),
        ("A", {"array": ["one"]}, "numbers"),
        ("A", {"array": [True]}, "numbers"),
        ("A", {"array": [1.0], "dtype": "object"}, "'object'"),
        ("A", {"array": [1.0], "shape": [7]}, "rows of one length"),
        ("A", {"eval": "1"}, "keys"),
    ],
)
def test_changed_values(tmp_path, field, value, said):
    path = changed(tmp_path, lambda _, f: f.update({field: value}))
    with pytest.raises(SlipangleError, match=said):
        load(path)


def test_value_out_of_range_names_file_and_record(tmp_path):
    def change(_, f):
        f["params"]["fields"]["mass"] = -1.0

    with pytest.raises(ParameterError, match=r"BicycleParams in '.*model\.json'.*vehicle mass.*expected"):
        load(changed(tmp_path, change, "bicycle"))


JUNK = (None, True, -1, 1e400, "x", [], {}, [[]], {"array": []}, {"float": "nan"}, {"class": "Trial", "fields": {}})


def places(node, path=()):
    yield path
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, child in items:
        yield from places(child, (*path, key))


@pytest.mark.parametrize("name", ["ARX, MIMO, delay, constant", "NARX", "bicycle on the ground"])
def test_junk_anywhere_is_a_sentence_or_a_model(tmp_path, name):
    path = save(ALL_MODELS[name], tmp_path / "model.json")
    text = path.read_text()
    rng = np.random.default_rng(0)
    every = [p for p in places(json.loads(text)) if p]
    chosen = every if len(every) < 60 else [every[i] for i in rng.choice(len(every), 60, replace=False)]
    for place in chosen:
        for junk in JUNK:
            content = json.loads(text)
            node = content
            for key in place[:-1]:
                node = node[key]
            node[place[-1]] = junk
            path.write_text(json.dumps(content))
            with suppress(SlipangleError):
                load(path)


def test_class_names_are_unique():
    """A file names classes without their module."""
    import importlib
    import pkgutil

    package = importlib.import_module("slipangle.models")
    seen = []
    for module in pkgutil.walk_packages(package.__path__, "slipangle.models."):
        content = vars(importlib.import_module(module.name)).values()
        seen += [c.__name__ for c in content if isinstance(c, type) and is_dataclass(c) and c.__module__ == module.name]
    assert len(seen) == len(set(seen))
    assert set(storage._known(())) <= {*seen, *storage.RECORDS, "TirFile", "TirLine", "Units"}


@pytest.mark.parametrize(
    ("value", "hint", "expected"),
    [
        (1.0, int, False),
        (True, int, False),
        (True, float, False),
        ((1.0, 2.0), tuple[float, float], True),
        ((1.0,), tuple[float, float], False),
        ([1.0], tuple[float, ...], False),
        (np.ones(1), np.ndarray | None, True),
        ("a", ca.SX, False),
    ],
)
def test_fits(value, hint, expected):
    assert fits(value, hint) is expected


def test_arx_with_wrong_shapes_in_the_file(tmp_path):
    path = changed(tmp_path, lambda _, f: f.update(outputs=["r", "v_y"]))
    with pytest.raises(FormatError, match=r"ARXModel in '.*' cannot be made of its fields"):
        load(path)
    assert isinstance(load(changed(tmp_path, lambda _, f: None)), ARXModel)


@pytest.mark.parametrize("name", ["ARX", "NARX", "ARMAX"])
def test_lags_without_end(tmp_path, name):
    def change(_, f):
        f["nk"] = [2**31] if isinstance(f["nk"], list) else 2**31

    with pytest.raises(ParameterError, match="samples back; expected at most 5000"):
        load(changed(tmp_path, change, name))
