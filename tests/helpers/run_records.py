"""Records of runs of a machine, as ``sysid run`` keeps them in a workspace."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from flights import cycle

from sysid.workspace import Workspace
from sysid_rl.run.cycle import Violation
from sysid_rl.run.run_record import EventRecorder, RunRecord

LATE = Violation("stale", "boom.cylinder", "fault", 0.12, 0.05, "boom.cylinder is 120 ms old; at most 50 ms")
RESULT: dict[str, Any] = {
    "ended": "fault", "state": "fault", "why": LATE.text, "turns": 300, "missed_deadlines": 1, "lost_cycles": 0,
    "lateness_us": {"p50": 70.0, "p99": 150.0, "max": 1200.0}, "turn_us": {"p50": 700.0, "p99": 900.0, "max": None},
    "verdicts": {"stale": 2}, "notes": ["ready", "armed"], "error_of": "helix by ik",
    "distance_mm": {"mean": 8.9123, "rmse": 10.0456, "max": 21.0}, "rmse_mm": [6.7, 5.9, 4.4], "max_mm": [17.2, 15.9, 12.8],
    "distance_by_second_mm": [[0, 10.0], [1, 21.0], [4, 9.0]],
}  # fmt: skip


def keep_run(place: Workspace, folder: Path, result: dict[str, Any] | None = RESULT) -> RunRecord:
    """A run that used plant ``autolog@2``; without a result it has only begun."""
    log = folder / "motion-20260503T141500" / "flight.mcap"
    log.parent.mkdir(parents=True, exist_ok=True)
    log.write_bytes(b"log")
    versions = {"autolog@2": place.models.find("autolog@2").digest, "autolog-forward@9": "00" * 32}
    about = {"name": "crane", "mode": "track", "machine": "autolog", "transport": "can", "versions": versions}
    record = RunRecord(place.root, log, about)
    record.begin()
    if result is not None:
        events = EventRecorder()
        for number in range(3):
            events.record(replace(cycle(number, 5), verdicts=(LATE,) if number else (), state="fault" if number else "running"))
        record.end(result, events)
    return record
