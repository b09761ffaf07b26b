"""`comparison_page`: what `slipangle.identify.judge.compare.compare` found, to look at."""

from dataclasses import replace

from slipangle.data.dataset import Channel, Dataset
from slipangle.identify.judge.compare import Comparison, horizon_errors
from slipangle.identify.judge.standing import standing
from slipangle.report.diagnostics import horizon_curves
from slipangle.report.page import Block, Figure, Finding, Findings, Page, Section, Verdict
from slipangle.report.plots import rainclouds, trajectories
from slipangle.report.style import pretty_unit
from slipangle.report.tables import Heading, Row, ScoreRow, Table, Tone, number, score_table
from slipangle.units import read_in


def comparison_page(result: Comparison, data: Dataset, *, train: Dataset | None = None, command: str = "") -> Page:
    """The best of ``result`` in a sentence, ranking, free runs, error clouds and errors over the horizon.

    ``data`` are the test data that the comparison was made with; ``command`` is what makes the page again. With
    ``train``, the training data, the best is judged beside simple models that are fitted to them
    (`slipangle.identify.judge.standing`); without, no model is called good. ``page.write("index.html")`` writes it.
    """
    good = [e for e in result.entries if not e.failure]
    ahead = {e.name: horizon_errors(e.model, data) for e in good}
    sections = [Section(title="Verdict", blocks=_verdict(result, data, train))]
    for output in result.outputs:
        factor, unit = read_in(output, data.unit(output))
        channel = Channel(output, unit)
        runs = {n: replace(t, y=factor * t.y, measured=factor * t.measured) for n, t in result.trajectories.items()}
        errors = {n: t.error[t.predicted, t.outputs.index(output)] for n, t in runs.items()}
        later = {n: replace(h, rmse=factor * h.rmse, free_run=factor * h.free_run) for n, h in ahead.items()}
        scores = {e.name: replace(e.scores[output], rmse=factor * e.scores[output].rmse) for e in good}
        rows = [ScoreRow(model=n, channel=output, unit=unit, kind="free run", **vars(s)) for n, s in scores.items()]
        blocks = (
            score_table(rows, title=f"Ranking, {output}"),
            Figure(title=f"Free runs, {output}", figure=trajectories(runs, channel)),
            Figure(title=f"Free-run error of {output}", figure=rainclouds(errors, channel=channel)),
            Figure(
                title=f"Error over the horizon, {output}",
                figure=horizon_curves(later, channel),
                caption="Prediction from measured outputs up to so long before; dashed: the free run.",
            ),
        )
        sections.append(Section(title=f"Output {output}", blocks=blocks))
    said = [(e, s) for e in result.entries for s in (e.failure, *e.warnings) if s]
    if said:
        items = tuple(Finding(sentence=f"{e.name}: {s}", tone="poor" if e.failure else "fair") for e, s in said)
        sections.append(Section(title="What to be careful about", blocks=(Findings(title="Warnings", items=items),)))
    return Page(
        title=f"{len(result.entries)} models on {result.data_name}",
        subtitle=f"Free runs over {result.n_samples} samples, {result.n_samples * data.dt:.4g} s, the best first",
        sections=tuple(sections),
        command=command,
    )


def _judged(result: Comparison, train: Dataset | None, data: Dataset) -> tuple[Tone, str]:
    """How good the best is, and why: the worst word of its outputs, never good with anything to doubt."""
    best = result.best
    if best.free_run is None or train is None:
        worthless = [o for o, s in best.scores.items() if s.fit <= 0]
        why = f" It is no better than a constant on {', '.join(worthless)}." if worthless else ""
        return (
            "poor" if worthless else "fair",
            f"{why} No simple model stands beside it, which would tell how good it is.",
        )
    run = best.free_run
    found = [standing(run, o, train, data) for o in result.outputs]
    doubted = best.warnings or any(e.failure for e in result.entries)
    words = [*("poor" if s.output in run.astray else s.word for s in found), *(["fair"] if doubted else [])]
    tone: Tone = "poor" if "poor" in words else "fair" if "fair" in words else "good"
    return tone, "".join(f" It {s.sentence}." for s in found)


def _verdict(result: Comparison, data: Dataset, train: Dataset | None) -> tuple[Block, ...]:
    """One table of models and outputs, and the best in a sentence."""
    rows, best = [], result.best
    tone, why = _judged(result, train, data)
    for place, e in enumerate(result.entries):
        count = len(e.model.fit_info.names) if e.model.fit_info is not None else None
        for output in result.outputs:
            factor, unit = read_in(output, data.unit(output))
            s = e.scores.get(output)
            error = None if s is None else f"{number(factor * s.rmse, 3)} {pretty_unit(unit)}"
            cells = (e.name, output, None if s is None else s.fit, None if s is None else s.vaf, error, count)
            rows.append(Row(cells, tone="poor" if e.failure else tone if place == 0 else None))
    words = Heading("model", words=True), Heading("output", words=True)
    numbers = Heading("fit", "%", 3), Heading("VAF", "%", 3), Heading("RMSE"), Heading("parameters")
    table = Table(title="Free runs", columns=(*words, *numbers), rows=tuple(rows))
    others = [e for e in result.entries[1:] if not e.failure]
    if best.failure:
        return (table, Verdict(title="None of them", sentence="No model has a free run over these data.", tone="poor"))
    fits = ", ".join(f"{best.scores[o].fit:.1f} % of {o}" for o in result.outputs)
    sentence = f"“{best.name}” comes nearest from inputs alone: {fits}."
    if others:
        share = 100 * (1 - best.error / others[0].error) if others[0].error > 0 else 0.0
        sentence += f" Its error is {share:.0f} % smaller than that of “{others[0].name}”, the next."
    sentence += why
    failed = len(result.entries) - len(others) - 1
    sentence += f" {failed} failed; why stands below." if failed else ""
    if best.warnings:
        count = len(best.warnings)
        sentence += f" {count} warning{'s' if count > 1 else ''} on it stand{'' if count > 1 else 's'} below."
    evidence = tuple(f"Output {output}" for output in result.outputs)
    return (table, Verdict(title=f"The best: {best.name}", sentence=sentence, tone=tone, evidence=evidence))
