"""`Shown`: results that show themselves, as one line in a terminal, a table in a notebook, a figure when asked."""

from importlib import import_module
from typing import Any


class Shown:
    """Mixin of results; a subclass says its line in `_words`, `slipangle.report.shown` has its table and its figure.

    A dataclass among them is declared with ``repr=False``.
    """

    def _words(self) -> str:
        """What the line says: of a result that is about a fitted model, its fit."""
        fit = getattr(getattr(self, "model", None), "fit_info", None)
        return fit._words() if isinstance(fit, Shown) else ""

    def __repr__(self) -> str:
        words = self._words()
        return f"<{type(self).__name__}{f': {words}' if words else ''}>"

    def _repr_html_(self) -> str:
        return (
            import_module("slipangle.report.shown").table(self)._repr_html_()
        )  # a room above all that show themselves

    def plot(self, *names: str) -> Any:
        """The figure of this result, of some channels or outputs where names are given: a Plotly figure.

        It shows in a notebook; `slipangle.save_figure` writes it for a publication.

        Raises ParameterError if there is no channel or output of a name.
        """
        return import_module("slipangle.report.shown").figure(self, names)  # a room above all that show themselves
