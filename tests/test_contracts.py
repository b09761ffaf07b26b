"""Nobody asks of what class a model is: what differs between models is a method or attribute of their contract."""

import ast
import importlib
from inspect import isabstract
from pathlib import Path

from slipangle.models.black_box.networks import Network
from slipangle.models.model import Model
from slipangle.models.parameters import ParameterSet
from slipangle.models.tires.simple import Tire

SOURCE = Path(__file__).parents[1] / "src" / "slipangle"
CONTRACTS = (Model, Tire, Network, ParameterSet)
TREES = {path: ast.parse(path.read_text()) for path in sorted(SOURCE.rglob("*.py"))}


def _asked(tree):
    """Names of the classes that are asked for, each with its line."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("isinstance", "issubclass"):
            place = node.args[1]
        elif isinstance(node, ast.MatchClass):
            place = node.cls
        else:
            continue
        for name in ast.walk(place):
            if isinstance(name, ast.Name | ast.Attribute):
                yield getattr(name, "id", getattr(name, "attr", "")), node.lineno


def _concrete_models():
    """Every class of a model, tire, network or parameter record that can be made, with the file that defines it."""
    found = {}
    for path, tree in TREES.items():
        names = [node.name for node in tree.body if isinstance(node, ast.ClassDef) and node.bases]
        if not names or (not path.is_relative_to(SOURCE / "models") and "reproduce/plants" not in path.as_posix()):
            continue
        module = importlib.import_module(".".join(path.relative_to(SOURCE.parent).with_suffix("").parts))
        for name in names:
            kind = getattr(module, name)
            if issubclass(kind, CONTRACTS) and kind not in CONTRACTS and not isabstract(kind):
                found[name] = path
    return found


def test_concrete_models_are_known_by_name_in_their_own_file_only():
    concrete = _concrete_models()
    assert {"OnGround", "EnsembleModel", "MagicFormulaTire", "MF61Coefficients", "MLP", "Bicycle"} <= concrete.keys()
    asked = [
        f"{path.relative_to(SOURCE)}:{line} asks for {name}"
        for path, tree in TREES.items()
        for name, line in _asked(tree)
        if concrete.get(name, path) != path
    ]
    assert asked == []
