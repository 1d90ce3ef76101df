"""Reports: HTML pages that open offline."""

from typing import TYPE_CHECKING

from mirdrake.core.deferred import defer

if TYPE_CHECKING:
    from mirdrake.report.run_report import write_report as write_report

__all__ = ["write_report"]

# The report of a run needs manoeuvres and Drake's plant, other reports do not.
__getattr__ = defer(__name__, {"write_report": "run_report"})
