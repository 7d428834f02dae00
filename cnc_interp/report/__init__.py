"""The HTML report of a plan."""

from cnc_interp.report.page import write_report

__all__ = ['write_report']
