"""Reports: HTML pages that open offline."""

from mirdrake.report.run_report import write_report

__all__ = ["write_report"]
