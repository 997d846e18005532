"""The report of a run: one HTML file, made from what the run folder holds."""

from rtgs.run.report.page import write_report

__all__ = ["write_report"]
