"""Figures, tables and one self-contained HTML page.

Every figure function returns a plotly figure that also shows in a notebook; `Page` puts figures, tables and verdicts
into one file that opens from disk.
"""

from slipangle.report.comparison import comparison_page
from slipangle.report.diagnostics import correlogram, forest, horizon_curves
from slipangle.report.drives import Signal, Span, signals, solver_histogram, solver_time
from slipangle.report.maps import Body, path_map, track_map
from slipangle.report.page import Fact, Figure, Finding, Findings, Grid, Listing, Number, Page, Section, Text, Verdict
from slipangle.report.parameters import correlation_table, parameter_table
from slipangle.report.plots import correlation, measured_vs_simulated, rainclouds, trajectories
from slipangle.report.records import Record, record_table
from slipangle.report.tables import (
    Heading,
    Row,
    ScoreRow,
    Table,
    orders_table,
    score_table,
)

__all__ = ["Fact", "Figure", "Finding", "Findings", "Grid", "Listing", "Number", "Page", "Section", "Text", "Verdict"]
__all__ += ["Heading", "Record", "Row", "ScoreRow", "Table"]
__all__ += ["correlation_table", "orders_table", "parameter_table", "record_table", "score_table"]
__all__ += ["Body", "Signal", "Span", "correlation", "correlogram", "forest", "horizon_curves", "measured_vs_simulated"]
__all__ += ["path_map", "rainclouds", "signals", "solver_histogram", "solver_time", "track_map", "trajectories"]
__all__ += ["comparison_page"]
