"""``slipangle init``: a commented job from a log, guesses marked."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable
from os.path import relpath
from pathlib import Path

from slipangle.commands import Answer, Commands
from slipangle.data.quality.survey import Guess, Survey, quoted, survey
from slipangle.data.readers.column import Column
from slipangle.errors import ConfigError
from slipangle.files import write_atomic

_ABOUT = """\
Write a job for a log: which column is which channel, in which unit, with which sign, as far as names and numbers
tell. What is guessed is marked with GUESS; read those lines, then: slipangle run FILE.toml.
"""
_NEEDED = ("delta", "v_x", "r")
_CAR = {"mass": (1500.0, "kg"), "wheelbase": (2.7, "m"), "l_f": (1.3, "m")}  # of a middling car, and their units
_RATES = (10.0, 20.0, 25.0, 50.0)  # Hz at which a car is identified


def add(commands: Commands) -> None:
    """Describe the command."""
    sub = commands.add("init", _init, "a commented job from a log, guesses marked", about=_ABOUT)
    sub.add_argument("file", metavar="LOG", help="a log of any format")
    sub.add_argument("--out", metavar="FILE.toml", help="the job to write; by default beside the log, with its name")
    sub.add_argument(
        "--kind", choices=("car", "bicycle"), default="car", help="what to identify (default: %(default)s)"
    )
    for name, (_, unit) in _CAR.items():
        sub.add_argument(f"--{name.replace('_', '-')}", type=float, metavar=unit, help=f"of the car [{unit}]")
    sub.add_argument(
        "--channel",
        action="append",
        default=[],
        metavar="NAME=HEADING[:UNIT]",
        help="where a channel stands, if it is not found or found wrongly",
    )
    sub.add_argument("--interactive", action="store_true", help="ask for every guess; Enter keeps it")
    sub.add_argument("--force", action="store_true", help="replace a job that is there")


def _init(options: argparse.Namespace) -> Answer:
    from slipangle.data.readers import open_log

    log = Path(options.file)
    out = Path(options.out) if options.out else log.with_suffix(".toml")
    if out.exists() and not options.force:
        raise ConfigError(f"'{out}' is there already; expected a new file: name another with --out, or say --force")
    found = survey(open_log(log))
    guesses = {g.channel: g for g in found.guesses} | {g.channel: g for g in map(said_channel, options.channel)}
    car = {n: (getattr(options, n), True) if getattr(options, n) else (value, False) for n, (value, _) in _CAR.items()}
    if options.interactive:
        _ask(guesses, car, input)
    missing = [n for n in _NEEDED if n not in guesses]
    if missing:
        names = ", ".join(repr(c.name) for c in found.channels[:12])
        names += f" and {more} more, told by slipangle inspect" if (more := len(found.channels) - 12) > 0 else ""
        raise ConfigError(
            f"'{log}' has no column that looks like {' or '.join(missing)} (columns: {names}); expected all of "
            f"{', '.join(_NEEDED)}: say {where(missing, found)}"
        )
    text = job_text(log, out, found, list(guesses.values()), car, options.kind)
    write_atomic(out, text)
    count = text.count("# GUESS")
    known = {"file": str(out), "columns": {g.channel: g.line for g in guesses.values()}, "guesses": count}
    words = f"{out}: {count} lines are guesses, marked GUESS; check them, then: slipangle run {out}"
    return Answer(known, words)


def where(missing: list[str], found: Survey) -> str:
    """How to say where a channel is that was not found; a speed may be the mean of those of the wheels."""
    said = f"--channel {missing[0]}=HEADING"
    wheels = [c.name for c in found.channels if re.search(r"wh(ee)?l.*(sp(ee)?d|vel)", c.name.lower()) and c.unit]
    rear = [name for name in wheels if re.search(r"(?i)(r[lr]|rear.*)$", name)]
    taken = rear if len(rear) > 1 else wheels
    if missing[0] != "v_x" or len(taken) < 2:
        return said
    total = " + ".join(f"'{name}'" for name in taken[:4])
    return f'{said}, or in a job v_x = {{ derive = "({total}) / {len(taken[:4])}" }}'


def said_channel(text: str) -> Guess:
    """A channel as ``--channel`` names it.

    Raises ConfigError if it names no column.
    """
    name, equals, source = text.partition("=")
    heading, _, unit = source.partition(":")
    if not (name and equals and heading):
        raise ConfigError(f"--channel {text} names no column; expected NAME=HEADING or NAME=HEADING:UNIT")
    return Guess(channel=name, column=Column(heading, unit or None), why=())


def _ask(guesses: dict[str, Guess], car: dict[str, tuple[float, bool]], ask: Callable[[str], str]) -> None:
    """Every guess once more, to the person at the terminal; an empty answer keeps it."""
    if not sys.stdin.isatty() and ask is input:
        raise ConfigError("--interactive asks at a terminal, and there is none; expected one: leave --interactive out")
    for name in dict.fromkeys((*_NEEDED, *guesses)):
        known = guesses.get(name)
        said = ask(f"{name}: HEADING[:UNIT] [{known.line if known else 'not found'}] ").strip()
        if said:
            guesses[name] = said_channel(f"{name}={said}")
    for name, (value, _) in list(car.items()):
        said = ask(f"{name} [{value:g} {_CAR[name][1]}] ").strip()
        if said:
            try:
                car[name] = (float(said), True)
            except ValueError:
                raise ConfigError(f"{name} is {said[:40]!r}; expected a number in {_CAR[name][1]}") from None


def job_text(
    log: Path, out: Path, found: Survey, guesses: list[Guess], car: dict[str, tuple[float, bool]], kind: str
) -> str:
    """The job: lines that are guesses end with GUESS and the reason; other channels stand below as comments."""
    near = _from(out.parent.resolve(), log.resolve())
    fastest = max((c.rate for c in found.channels), default=0.0)
    rate = max((r for r in _RATES if r <= 0.6 * fastest), default=None)
    there = [n for n in ("r", "v_y", "a_y") if any(g.channel == n for g in guesses)]
    inputs = [*_NEEDED[:2], *(n for n in ("delta_r", "M_z") if any(g.channel == n for g in guesses) and kind == "car")]
    outputs = [n for n in there if n != "a_y" or (kind == "car" and "v_y" not in there)]  # what that kind fits
    lines = [
        f"# A job for {log.name}, by 'slipangle init'. Lines with GUESS want a look; then: slipangle run {out.name}",
        f"title = {quoted(log.stem)}",
        f"out = {quoted(f'slipangle-out/{log.stem}')}",
        "",
        "[data]",
        f"file = {quoted(near)}",
        *(f"{line}  # GUESS: {why}" for line, why in found.settings),
        f"inputs = [{', '.join(map(quoted, inputs))}]",
        f"outputs = [{', '.join(map(quoted, outputs))}]",
        *([f"rate = {rate:.1f}  # Hz, after a zero-phase low-pass"] if rate else []),
        'hold = "mean"  # the steering moves between samples',
        "",
        "# delta, r, v_y and a_y are positive to the left: sign = -1 where the log counts to the right",
        '[data.columns]  # unit, scale, offset, sign, ratio (hand wheel over road wheel), derive = "curvature * v_x"',
    ]
    for g in guesses:
        lines.append(g.line + (f"  # GUESS: {'; '.join(g.why)}" if g.why else ""))
    used = {str(g.column.source) for g in guesses}
    others = [c for c in found.channels if c.name not in used]
    lines += [f"# also there: {c.name} [{c.unit or 'no unit'}], {c.low:.4g} to {c.high:.4g}" for c in others[:60]]
    lines += ["", "[[model]]", f'name = "{kind}"', f'kind = "{kind}"', *_model(kind, car), *_controller(kind), ""]
    return "\n".join(line.replace("\n", " ") for line in lines)


def _controller(kind: str) -> list[str]:
    """What drives the identified car, to be switched on."""
    table = ["[controller]", f'model = "{kind}"', "v_x = 20.0  # m/s, through the lane change of ISO 3888-1"]
    return ["", "# Predictive control with that model, in simulation; without the # it is on the page too:"] + [
        f"# {line}" for line in table
    ]


def _from(folder: Path, file: Path) -> str:
    """A file as the job says it: from the job's folder on, with slashes, so that both can move to another machine."""
    try:
        return Path(relpath(file, folder)).as_posix()
    except ValueError:  # on another drive of Windows
        return str(file)


def _model(kind: str, car: dict[str, tuple[float, bool]]) -> list[str]:
    def guess(*names: str) -> str:
        return "" if all(car[n][1] for n in names) else "  # GUESS: put your car's"

    value = {n: v for n, (v, _) in car.items()}
    if kind == "car":
        return [f"{n} = {v:g}{guess(n)}" for n, v in value.items()]
    l_r = value["wheelbase"] - value["l_f"]
    start = {"inertia_z": value["mass"] * value["l_f"] * l_r, "C_f": 60 * value["mass"], "C_r": 60 * value["mass"]}
    entries = ", ".join(f"{n} = {v:g}" for n, v in (value | start).items())
    return [f"car = {{ {entries} }}{guess(*value)}", 'free = ["C_f", "C_r", "inertia_z"]  # the others stay']
