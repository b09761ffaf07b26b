"""``slipangle tire eval | fit | plot | convert``."""

from __future__ import annotations

import argparse
import math
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slipangle.commands import Answer, Commands
from slipangle.commands.progress import Bar
from slipangle.errors import ConfigError, FormatError, ModelWarning, ParameterError, nearest
from slipangle.files import check_output, replaced

if TYPE_CHECKING:
    from slipangle.data.tire_data import TireData
    from slipangle.models.tires.magic_formula.axes import AxisSystem
    from slipangle.models.tires.magic_formula.terms import Conventions
    from slipangle.models.tires.simple import Tire

_MODELS = "mf61, magic, linear, brush, dugoff, rbf:N, mlp:N,N,... (N neurons)"
_AXES: dict[str, AxisSystem] = {"iso": "ISO-W", "sae": "SAE", "adapted-sae": "adapted SAE"}
_PRESETS = ("book", "mfeval")  # of `slipangle.models.tires.magic_formula.terms.Conventions`
_FILES = "a .tir file, or a tire that slipangle saved as .json"


def add(commands: Commands) -> None:
    """Describe the commands."""
    about = (
        "Evaluate, fit, draw and convert tires. A positive slip ratio drives, a positive slip angle gives\n"
        "a force to the left; loads are positive. --slip-ratio is s = (omega r - v_x) / max(|v_x|, |omega r|),\n"
        "--kappa the practical slip (omega r - v_x) / |v_x| of tire files and rigs; see docs/tires.md."
    )
    actions = commands.group("tire", "tires: eval, fit, plot, convert", about)
    sub = actions.add("eval", _eval, "forces and moments at given slips and loads")
    _tire(sub)
    _conditions(sub)
    sub = actions.add("fit", _fit, "fit a tire to runs of a rig (FSAE TTC .mat, .dat; TYDEX .tdx)")
    sub.add_argument("files", nargs="+", metavar="FILE", help="runs of one tire: cornering, drive/brake")
    sub.add_argument("--model", default="mf61", help=f"{_MODELS} (default: %(default)s)")
    sub.add_argument("--radius", type=float, metavar="M", help="unloaded radius for mf61 [m]; 0.3, with a warning")
    sub.add_argument("--fnomin", type=float, metavar="N", help="nominal load for mf61 [N] (default: the median load)")
    sub.add_argument("--side", choices=("LEFT", "RIGHT"), help="of the vehicle that the tire was measured for")
    sub.add_argument(
        "--start", metavar="FILE.tir", help="tire that mf61 starts from and keeps where the data are silent"
    )
    sub.add_argument("--units", choices=("US", "metric"), help="where the file names none (default: by the pressure)")
    sub.add_argument("--keep-warm-up", action="store_true", help="keep samples from before the tread is warm")
    sub.add_argument("--offsets", action="store_true", help="move each run to the level of the first one")
    sub.add_argument("--inputs", default="", help="of networks besides slip: load, or load,camber")
    sub.add_argument("--seed", type=int, default=0, help="of the random starts (default: %(default)s)")
    sub.add_argument("--out", metavar="FILE", help="write the tire: .tir (mf61) or .json")
    sub.add_argument("--page", metavar="FILE.html", help="write a page with measurements, fit and residuals")
    sub = actions.add("plot", _plot, "a page of force over slip and load, combined slip")
    _tire(sub)
    sub.add_argument("--load", type=_numbers, default=(), metavar="N,...", help="loads [N]")
    sub.add_argument("--camber", type=float, default=0.0, metavar="DEG", help="inclination [deg]")
    sub.add_argument("--out", default="tire.html", metavar="FILE.html", help="default: %(default)s")
    sub = actions.add("convert", _convert, "write a tire as .tir in SI units, or as .json")
    _tire(sub)
    sub.add_argument("out", metavar="OUT", help=".tir or .json")
    sub.add_argument("--mirror", action="store_true", help="for the other side of the vehicle (.json only)")


def _tire(sub: argparse.ArgumentParser) -> None:
    """The tire, and how its file is to be read."""
    sub.add_argument("file", metavar="FILE", help=_FILES)
    sub.add_argument("--force", action="store_true", help="use coefficients outside their range as they stand")
    sub.add_argument(
        "--conventions",
        type=conventions,
        metavar="NAME",
        help=f"where codes differ: {', '.join(_PRESETS)}, or name=value,... such as camber=angle (default: book)",
    )
    sub.add_argument(
        "--file-axes", choices=_AXES, help="axes of the coefficients (default: by the sign of the cornering stiffness)"
    )


def _conditions(sub: argparse.ArgumentParser) -> None:
    slip = sub.add_mutually_exclusive_group()
    ratio = "s, such as 0,0.05 or 0:0.2:0.05"
    slip.add_argument("--slip-ratio", type=_numbers, default=(0.0,), metavar="LIST", help=ratio)
    slip.add_argument("--kappa", type=_numbers, metavar="LIST", help="practical slip instead of s")
    sub.add_argument("--slip-angle", type=_numbers, default=(0.0,), metavar="LIST", help="[deg], such as -10:10:2")
    sub.add_argument("--load", type=_numbers, required=True, metavar="LIST", help="[N], such as 2000,4000")
    sub.add_argument("--camber", type=_numbers, default=(0.0,), metavar="LIST", help="[deg]")
    sub.add_argument("--pressure", type=float, metavar="KPA", help="inflation pressure [kPa] (default: the file's)")
    sub.add_argument("--speed", type=float, metavar="M/S", help="forward speed [m/s] (default: the file's LONGVL)")
    sub.add_argument(
        "--axes", choices=_AXES, help="of slip angles and results; default: positive slip angle, force to the left"
    )
    sub.add_argument("--extrapolate", action="store_true", help="evaluate outside the file's range, with a warning")


def _eval(options: argparse.Namespace) -> Answer:
    from slipangle.report.tires import evaluate_table

    tire = _read(options, extrapolate=options.extrapolate)
    practical = options.kappa is not None
    with _warnings_printed(), _named_as_options():
        angle, camber = ([math.radians(a) for a in angles] for angles in (options.slip_angle, options.camber))
        table = evaluate_table(
            tire,
            slip_ratio=options.kappa if practical else options.slip_ratio,
            slip_angle=angle,
            load=options.load,
            camber=camber,
            pressure=None if options.pressure is None else 1e3 * options.pressure,
            speed=options.speed,
            axes=_AXES[options.axes] if options.axes else "slipangle",
            practical=practical,
        )
    heads = [f"{c.title} [{c.unit}]" for c in table.columns]
    return Answer([dict(zip(heads, row.cells, strict=True)) for row in table.rows], table.to_text().rstrip("\n"))


def _fit(options: argparse.Namespace) -> Answer:
    from slipangle.data.readers.tydex import read_rig
    from slipangle.data.rig_runs import disagreements, without_offsets
    from slipangle.data.tire_data import joined
    from slipangle.identify.tires.relaxation import with_relaxation
    from slipangle.models.storage import save
    from slipangle.report.page import Fact
    from slipangle.report.parameters import parameter_table
    from slipangle.report.tires import fit_errors, informations, tire_page

    model = _estimator(options)
    for path in (options.out, options.page):
        if path:
            check_output(Path(path).parent)
    if options.out and _suffix(options.out) == ".tir" and options.model != "mf61":
        raise FormatError(f"a {options.model} tire has no place in a .tir file; expected .json, or --model mf61")
    with Bar(quiet=options.json or options.quiet) as bar:
        bar(0.05, "reading")
        parts = [read_rig(path, units=options.units, warm_up=not options.keep_warm_up) for path in options.files]
        data = joined(parts)
        apart = disagreements(data, [part.name for part in parts])
        data = without_offsets(data) if options.offsets else replace(data, notes=(*data.notes, *apart))
        bar(0.2, f"fitting {options.model} to {data.n_samples} samples")
        with _warnings_printed():
            tire = model(data)
        if options.side:
            tire = replace(tire, side=options.side)
        relaxed: tuple[str, ...] = ()
        if options.model == "mf61":
            bar(0.9, "relaxation length")
            tire, relaxed = with_relaxation(tire, data)
    written = {path: replaced(path) for path in (options.out, options.page) if path}
    if options.out:
        _write(tire, options.out, save)
    if options.page:
        facts = tuple(Fact(label="file", value=path) for path in options.files)
        tire_page(tire, title=data.name, data=data, facts=facts, command=options.said).write(options.page)
    errors = fit_errors(tire, data)
    tables = [parameter_table(info, title=f"Coefficients{name}") for name, info in informations(tire)]
    content = {
        "samples": data.n_samples,
        "notes": [*data.notes, *relaxed],
        "errors": [list(r.cells) for r in errors.rows],
    }
    content["coefficients"] = [
        {"name": n, "value": float(v), "std": float(s)}
        for _, info in informations(tire)
        for n, v, s in zip(info.names, info.values, info.std, strict=True)
    ]
    content["written"] = list(written)
    words = [*data.notes, *relaxed, *(table.to_text() for table in (errors, *tables))]
    return Answer(content, "\n".join([*words, *(f"wrote {path}{before}" for path, before in written.items())]))


def _plot(options: argparse.Namespace) -> Answer:
    from slipangle.report.tires import tire_page

    check_output(Path(options.out).parent)
    tire = _read(options, extrapolate=True)
    before = replaced(options.out)
    page = tire_page(
        tire,
        title=Path(options.file).name,
        loads=options.load,
        camber=math.radians(options.camber),
        command=options.said,
    )
    return _written(page.write(options.out), before)


def _convert(options: argparse.Namespace) -> Answer:
    from slipangle.models.storage import save

    tire: Any = _read(options, extrapolate=False)
    check_output(Path(options.out).parent)
    before = replaced(options.out)
    if options.mirror:
        if tire.mirrored is None:
            raise ConfigError("only a Magic Formula tire can be mirrored; expected a .tir file: leave --mirror out")
        tire = replace(tire, mirrored=not tire.mirrored)
    if tire.source is not None:
        tire = replace(tire, source=None)  # every coefficient anew, in SI units
    return _written(_write(tire, options.out, save), before)


def _written(path: Path, before: str) -> Answer:
    return Answer({"written": str(path), "replaced": bool(before)}, f"wrote {path}{before}")


def _read(options: argparse.Namespace, *, extrapolate: bool) -> Tire:
    """The tire that the options of `_tire` name."""
    axes = _AXES[options.file_axes] if options.file_axes else None
    return read_tire(
        options.file, extrapolate=extrapolate, conventions=options.conventions, axes=axes, force=options.force
    )


def read_tire(
    path: str | Path,
    *,
    extrapolate: bool = False,
    conventions: Conventions | None = None,
    axes: AxisSystem | None = None,
    force: bool = False,
) -> Tire:
    """As `slipangle.models.tires.files.read_tire`, its warnings printed."""
    from slipangle.models.tires import files

    outside = "extrapolate" if extrapolate else "error"
    with _warnings_printed():
        return files.read_tire(path, outside=outside, conventions=conventions, axes=axes, force=force)


def _suffix(out: str) -> str:
    suffix = Path(out).suffix.lower()
    if suffix not in (".tir", ".json"):
        raise FormatError(f"'{out}' ends in neither .tir nor .json; expected one of them: name the tire's file so")
    return suffix


def _write(tire: Any, out: str, save: Any) -> Path:
    from slipangle.identify.tires.written import fitted_file

    if _suffix(out) == ".json":
        return save(tire, out)
    if tire.mirrored:
        raise FormatError("a mirrored tire has no place in a .tir file; expected .json as suffix, or no --mirror")
    return tire.write_tir(out) if tire.fit_info is None or tire.mirrored is None else fitted_file(tire).write(out)


def _estimator(options: argparse.Namespace) -> Any:
    """The fit that ``--model`` names, as a function of the data."""
    from slipangle.identify.tires.curves import MagicCurveFit, MLPCurveFit, RBFCurveFit
    from slipangle.identify.tires.magic_formula import MagicFormulaFit, typical
    from slipangle.identify.tires.whole_tire import CurveTireFit
    from slipangle.models.tires.physical import BrushTire, DugoffTire
    from slipangle.models.tires.simple import LinearTire

    name, seed = options.model, options.seed
    inputs: Any = tuple(part for part in options.inputs.split(",") if part)
    for option, given in (("--radius", options.radius), ("--fnomin", options.fnomin), ("--start", options.start)):
        if given and name != "mf61":
            raise ConfigError(f"{option} is for mf61, the model is {name}; expected one of both: leave it out")
        if given and options.start and option != "--start":
            raise ConfigError(f"{option} and --start are given; expected one of both: the start tire has its own size")
    if options.side and name != "mf61":
        raise ConfigError(f"--side is for mf61, the model is {name}; expected one of both: leave it out")
    if options.start:
        start: Any = read_tire(options.start, extrapolate=True)
        return MagicFormulaFit(start=start, seed=seed).fit
    if name == "mf61":

        def from_typical(data: TireData) -> Any:
            if options.radius is None:
                text = (
                    "no unloaded radius is given: 0.3 m is taken, which scales moments and file: name it with --radius"
                )
                warnings.warn(text, ModelWarning, stacklevel=2)
            start = typical(data, radius=options.radius or 0.3, nominal_load=options.fnomin)
            return MagicFormulaFit(start=start, seed=seed).fit(data)

        return from_typical
    if name == "magic":
        curve = MagicCurveFit(seed=seed)
        return CurveTireFit(longitudinal=curve, lateral=curve).fit
    physical: dict[str, Any] = {"linear": LinearTire, "brush": BrushTire, "dugoff": DugoffTire}
    if name in physical:
        return lambda data: _physical(physical[name](C_alpha=5e4, C_s=5e4), data, seed)
    network = re.fullmatch(r"(rbf|mlp):(\d+(?:,\d+)*)", name)
    if network is None:
        raise ConfigError(f"there is no tire model '{name}'; expected one of {_MODELS}")
    sizes = tuple(int(n) for n in network[2].split(","))
    if network[1] == "rbf" and len(sizes) != 1:
        raise ConfigError(f"a radial basis function network has one layer, '{name}' names {len(sizes)}; expected rbf:N")
    fit = RBFCurveFit(neurons=sizes[0], seed=seed) if network[1] == "rbf" else MLPCurveFit(hidden=sizes, seed=seed)
    return CurveTireFit(longitudinal=fit, lateral=fit, inputs=inputs).fit


def _physical(start: Any, data: TireData, seed: int) -> Any:
    """Stiffness in the directions that the data move in, and friction where the model has it."""
    from slipangle.identify.tires.whole_tire import TireFit

    linear = "mu" not in start.metadata()
    limit = 0.02 if linear else 10.0
    near = (abs(data.slip_angle) < limit) & (abs(data.slip_ratio) < limit)
    moves = {"C_alpha": data.slip_angle[near], "C_s": data.slip_ratio[near]}
    free = tuple(name for name, slip in moves.items() if len(slip) and slip.max() - slip.min() > 0.02)
    free += () if linear else ("mu",)
    return TireFit(start=start, free=free, slip_limit=limit, seed=seed).fit(data)


def _numbers(text: str) -> tuple[float, ...]:
    """``1,2,3`` or ``start:stop:step``, both ends included.

    >>> _numbers("0:0.2:0.1"), _numbers("5,-3")
    ((0.0, 0.1, 0.2), (5.0, -3.0))
    """
    try:
        if ":" in text:
            start, stop, step = (float(part) for part in text.split(":"))
            count = math.floor((stop - start) / step + 1e-9) + 1
            if not 1 <= count <= 100_000:
                raise ValueError
            return tuple(round(start + k * step, 12) for k in range(count))
        return tuple(float(part) for part in text.split(","))
    except (ValueError, ZeroDivisionError, OverflowError):
        raise argparse.ArgumentTypeError(
            f"'{text}' is no list of numbers; expected such as 0,0.05 or 0:0.2:0.05"
        ) from None


def conventions(text: str) -> Conventions:
    """A preset, or choices by name, or both: ``mfeval,camber=sine``.

    >>> conventions("mfeval,camber=sine").camber
    'sine'
    """
    from slipangle.models.tires.magic_formula.terms import PRESETS

    first, *rest = text.split(",")
    chosen, parts = (PRESETS[first], rest) if first in PRESETS else (PRESETS["book"], [first, *rest])
    known = {f.name: f.default for f in fields(chosen)}
    values: dict[str, Any] = {}
    for part in parts:
        name, equals, value = part.partition("=")
        if not equals or name not in known:
            raise argparse.ArgumentTypeError(
                f"'{part}' is no convention; {nearest(name, [*PRESETS, *known])}: use one of these, the latter as "
                "name=value"
            )
        try:
            kind = type(known[name])
            values[name] = value.lower() in ("true", "yes", "1") if kind is bool else kind(value)
            chosen = replace(chosen, **values)
        except (ValueError, ParameterError) as error:
            raise argparse.ArgumentTypeError(str(error)) from None
    return chosen


@contextmanager
def _named_as_options() -> Iterator[None]:
    """Errors with the option of the command line where they offer an argument."""
    try:
        yield
    except ParameterError as error:
        raise ParameterError(str(error).replace("outside='extrapolate'", "--extrapolate")) from None


@contextmanager
def _warnings_printed() -> Iterator[None]:
    """Show warnings as plain sentences on standard error, each once."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for sentence in dict.fromkeys(str(w.message) for w in caught):
        print(f"slipangle: {sentence}", file=sys.stderr)
