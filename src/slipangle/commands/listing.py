"""``slipangle list``: what can be asked for by name, from this package and from others."""

import argparse
from importlib import import_module

from slipangle.commands import Answer, Commands
from slipangle.errors import ConfigError, nearest
from slipangle.registry import Registry

REGISTRIES = {  # what a user calls it: where it is
    "models": "slipangle.workflow.kinds:KINDS",
    "controllers": "slipangle.workflow.drive:CONTROLLERS",
    "plants": "slipangle.workflow.drive:PLANTS",
    "estimators": "slipangle.workflow.drive:ESTIMATORS",
    "fits": "slipangle.workflow.kinds:FITS",
    "sections": "slipangle.workflow.page:SECTIONS",
    "readers": "slipangle.data.readers:READERS",
    "signals": "slipangle.data.signals:SIGNALS",
    "records": "slipangle.models.storage:RECORDS",
}


def add(commands: Commands) -> None:
    """Describe the command."""
    more = "A package adds one with a decorator or an entry point of the group that stands in brackets."
    sub = commands.add("list", _list, "kinds of models, controllers, signals and so on, by name", more=more)
    sub.add_argument("what", nargs="*", metavar="WHAT", help=f"{', '.join(REGISTRIES)}; by default all")


def _list(options: argparse.Namespace) -> Answer:
    """What a job or a call can ask for by name, each with the module that it comes from.

    Those of installed packages are among them.
    """
    listed, words = {}, []
    for what in options.what or REGISTRIES:
        if what not in REGISTRIES:
            raise ConfigError(f"there is no list of '{what}'; {nearest(what, REGISTRIES)}: use one of these names")
        module, _, name = REGISTRIES[what].partition(":")
        registry: Registry = getattr(import_module(module), name)
        listed[what] = {key: _home(thing) for key, thing in registry.items()}
        words.append("\n  ".join([f"{what} [{registry.group}]", *(f"{k:28} {v}" for k, v in listed[what].items())]))
    return Answer(listed, "\n".join(words))


def _home(thing: object) -> str:
    """The module of a class or function, or of what it stands for."""
    from slipangle.workflow.entries import Made

    if isinstance(thing, Made):
        return thing.of.__module__
    own = getattr(thing, "read", None) or getattr(thing, "model", None) or thing
    return getattr(own, "__module__", type(own).__module__)
