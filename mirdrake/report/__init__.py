"""Reports: a run as one HTML page that opens anywhere, offline."""

from mirdrake.report.run_report import RunLike, write_report

__all__ = ["RunLike", "write_report"]
