"""What the node tells of itself on /diagnostics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from boxgrasp_msgs.msg import Status
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

_NOBODYS_FAULT = (Status.SUCCEEDED, Status.CANCELLED)


@dataclass(frozen=True)
class Record:
    """What has happened so far.

    Attributes:
        answers: requests answered, those that ask a person included.
        asks: those of them that ask a person.
        failures: requests without an answer.
        last: status of the last request, None before the first.
        timings_ms: of the last answer, by stage.
    """

    answers: int = 0
    asks: int = 0
    failures: int = 0
    last: Status | None = None
    timings_ms: Mapping[str, float] | None = None

    def answered(self, asks: bool, timings_ms: Mapping[str, float]) -> Record:
        """The record after an answer.

        Args:
            asks: whether it asks a person.
            timings_ms: by stage.

        Returns:
            A new one.
        """
        return replace(
            self,
            answers=self.answers + 1,
            asks=self.asks + asks,
            last=Status(code=Status.SUCCEEDED),
            timings_ms=dict(timings_ms),
        )

    def failed(self, status: Status) -> Record:
        """The record after a request without an answer.

        Args:
            status: of it.

        Returns:
            A new one.
        """
        return replace(self, failures=self.failures + 1, last=status)


def diagnostics(
    record: Record, name: str, stamp: Time, view_age_s: float | None
) -> DiagnosticArray:
    """The message of a record.

    Args:
        record: so far.
        name: of the node.
        stamp: now.
        view_age_s: of the newest view, None where none came.

    Returns:
        One status: OK, or WARN after a request that failed or while no view comes.
    """
    told = DiagnosticStatus(name=f"{name}: grasp selection", level=DiagnosticStatus.OK)
    told.message = "ready"
    if record.last is not None and record.last.code not in _NOBODYS_FAULT:
        told.level, told.message = DiagnosticStatus.WARN, record.last.message
    elif view_age_s is None:
        told.level, told.message = DiagnosticStatus.WARN, "no view has come"
    elif record.answers:
        told.message = "the last request was answered"
    values = {
        "answers": str(record.answers),
        "of them ask a person": str(record.asks),
        "failures": str(record.failures),
        "age of the newest view, s": "none" if view_age_s is None else f"{view_age_s:.2f}",
        **{f"{stage}, ms": f"{ms:.2f}" for stage, ms in (record.timings_ms or {}).items()},
    }
    told.values = [KeyValue(key=key, value=value) for key, value in values.items()]
    array = DiagnosticArray(status=[told])
    array.header.stamp = stamp
    return array
