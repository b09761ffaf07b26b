"""`comparison_page`: what `slipangle.identify.judge.compare.compare` found, to look at."""

from slipangle.data.dataset import Channel, Dataset
from slipangle.identify.judge.compare import Comparison, horizon_errors
from slipangle.report.diagnostics import horizon_curves
from slipangle.report.page import Figure, Finding, Findings, Page, Section
from slipangle.report.plots import rainclouds, trajectories
from slipangle.report.tables import ScoreRow, score_table


def comparison_page(result: Comparison, data: Dataset, *, command: str = "") -> Page:
    """Ranking, free runs, error clouds and errors over the horizon of all models that did not fail.

    ``data`` are the test data that the comparison was made with; ``command`` is what makes the page again.
    ``page.write("comparison.html")`` writes it.
    """
    good = [e for e in result.entries if not e.failure]
    ahead = {e.name: horizon_errors(e.model, data) for e in good}
    sections = []
    for output in result.outputs:
        channel = Channel(output, data.unit(output))
        errors = {n: t.error[t.predicted, t.outputs.index(output)] for n, t in result.trajectories.items()}
        rows = [
            ScoreRow(model=e.name, channel=output, unit=channel.unit, kind="free run", **vars(e.scores[output]))
            for e in good
        ]
        blocks = (
            score_table(rows, title=f"Ranking, {output}"),
            Figure(title=f"Free runs, {output}", figure=trajectories(result.trajectories, channel)),
            Figure(title=f"Free-run error of {output}", figure=rainclouds(errors, channel=channel)),
            Figure(
                title=f"Error over the horizon, {output}",
                figure=horizon_curves(ahead, channel),
                caption="Prediction from measured outputs up to so long before; dashed: the free run.",
            ),
        )
        sections.append(Section(title=f"Output {output}", blocks=blocks))
    said = [(e, s) for e in result.entries for s in (e.failure, *e.warnings) if s]
    if said:
        items = tuple(Finding(sentence=f"{e.name}: {s}", tone="poor" if e.failure else "fair") for e, s in said)
        sections.append(Section(title="What to be careful about", blocks=(Findings(title="Warnings", items=items),)))
    return Page(
        title="Comparison of models",
        subtitle=f"{result.data_name}, {result.n_samples} samples that none was fitted to",
        sections=tuple(sections),
        command=command,
    )
