"""Figures, tables and one self-contained HTML page.

Every figure function returns a plotly figure that also shows in a notebook; `Page` puts figures, tables and verdicts
into one file that opens from disk.
"""

from slipangle.report.comparison import comparison_page
from slipangle.report.diagnostics import correlogram, forest, horizon_curves
from slipangle.report.drives import Signal, Span, signals, solver_histogram, solver_time
from slipangle.report.maps import Body, path_map, track_map
from slipangle.report.page import Fact, Figure, Finding, Findings, Grid, Number, Page, Section, Text, Verdict
from slipangle.report.plots import correlation, measured_vs_simulated, rainclouds, trajectories
from slipangle.report.records import Record, record_table
from slipangle.report.tables import Heading, Row, ScoreRow, Table, correlation_table, parameter_table, score_table

__all__ = [
    "Body",
    "Fact",
    "Figure",
    "Finding",
    "Findings",
    "Grid",
    "Heading",
    "Number",
    "Page",
    "Record",
    "Row",
    "ScoreRow",
    "Section",
    "Signal",
    "Span",
    "Table",
    "Text",
    "Verdict",
    "comparison_page",
    "correlation",
    "correlation_table",
    "correlogram",
    "forest",
    "horizon_curves",
    "measured_vs_simulated",
    "parameter_table",
    "path_map",
    "rainclouds",
    "record_table",
    "score_table",
    "signals",
    "solver_histogram",
    "solver_time",
    "track_map",
    "trajectories",
]
