"""Why a run ended."""

from dataclasses import dataclass
from enum import StrEnum


class StopReason(StrEnum):
    """Kind of the end of a run; ``stop_reason`` in summary.json."""

    DURATION = "duration"
    LAPS = "laps"
    CONDITION = "condition"
    INTERRUPTED = "interrupted"
    DIVERGED = "diverged"
    FAILED = "failed"
    KILLED = "killed"


@dataclass(frozen=True)
class Stop:
    """End of a run.

    Attributes:
        reason: its kind.
        detail: what diverged, failed, or ended the run, in one line; may be empty. ``stop_detail`` in summary.json.
    """

    reason: StopReason
    detail: str = ""

    def __str__(self) -> str:
        return f"{self.reason}: {self.detail}" if self.detail else str(self.reason)

    @property
    def as_asked(self) -> bool:
        """Whether the run ended as its diagram or its caller asked."""
        return self.reason in {StopReason.DURATION, StopReason.LAPS, StopReason.CONDITION}
