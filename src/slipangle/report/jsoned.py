"""JSON that can stand inside a script element of a page."""

import json

from plotly.utils import PlotlyJSONEncoder


def jsoned(value: object) -> str:
    """The value as JSON in which nothing ends the element."""
    text = json.dumps(value, cls=PlotlyJSONEncoder, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e")
