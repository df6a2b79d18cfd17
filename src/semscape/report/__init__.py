"""The report of a run: its figures as JSON, one self-contained HTML page, and the console's progress lines."""

from semscape.report.hillshade import hillshade
from semscape.report.html import render_html
from semscape.report.json import report_to_dict
from semscape.report.run import write_run

__all__ = ["hillshade", "render_html", "report_to_dict", "write_run"]
