"""The record of a run in the workspace: its result, states and violations, for the pages of the workspace.

The record is written when the run begins, and again with its result at the end: a run that was killed stays without one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sysid.files import json_text
from sysid.root import Root
from sysid_rl.run.cycle import Cycle, Recorder

#: Folder of the records in a workspace, and most events of one.
FOLDER, MOST = "flights", 500
#: What :meth:`RunRecord.begin` states where only the end of a run knows it.
OPEN: dict[str, Any] = {"ended": None, "state": None, "why": "", "events": [], "sha256": ""}


class EventRecorder:
    """A recorder of the changes of state, and of violations: one event for consecutive cycles with the same violation.

    Args:
        most: events kept; :attr:`lost` counts the others.
    """

    fault = ""

    def __init__(self, most: int = MOST) -> None:
        self.events: list[dict[str, Any]] = []
        self.lost = 0
        self._most, self._begin, self._state = most, 0, ""
        self._open: dict[tuple[str, str, str], dict[str, Any]] = {}

    def record(self, cycle: Cycle) -> None:
        self._begin = self._begin or cycle.at_ns
        time_s = 1e-9 * (cycle.at_ns - self._begin)
        if cycle.state != self._state:
            self._state = cycle.state
            self._add({"time_s": time_s, "kind": "state", "text": cycle.state})
        going_on: dict[tuple[str, str, str], dict[str, Any]] = {}
        for found in cycle.verdicts:
            key = (found.check, found.target, str(found.reaction))
            event = self._open.get(key)
            if event is None:
                event = {"time_s": time_s, "kind": "violation", "text": found.text, "cycles": 0}
                event |= {"check": found.check, "target": found.target, "reaction": found.reaction}
                self._add(event)
            event["cycles"] += 1
            going_on[key] = event
        self._open = going_on

    def _add(self, event: dict[str, Any]) -> None:
        if len(self.events) < self._most:
            self.events.append(event)
        else:
            self.lost += 1


class Recorders:
    """Recorders that do not fail, and the flight log once it is open."""

    def __init__(self, *others: Recorder) -> None:
        self.others = others
        self.log: Recorder | None = None

    def record(self, cycle: Cycle) -> None:
        for recorder in self.others:
            recorder.record(cycle)
        if self.log is not None:
            self.log.record(cycle)

    @property
    def fault(self) -> str:
        return self.log.fault if self.log is not None else ""


class RunRecord:
    """The file of one run in a workspace.

    Args:
        root: of the workspace.
        log: the flight log.
        about: what is known at the beginning: ``name``, ``mode``, ``machine``, ``versions``.
    """

    def __init__(self, root: Root, log: Path, about: Mapping[str, Any]) -> None:
        self._root, self._log = root, log
        self.path = f"{FOLDER}/{log.parent.name}.json"
        self._about = {
            "schema": 1,
            "started": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
            "log": str(log.absolute()),
            **about,
        }

    def begin(self) -> None:
        """Write the record of a run that has not ended.

        Raises:
            OSError, StoreError: the workspace cannot be written.
        """
        self._write(OPEN)

    def end(self, result: Mapping[str, Any], events: EventRecorder) -> None:
        """Write the result, with the sha256 of the log, by which datasets that are made from it are found.

        Raises:
            OSError, StoreError: the workspace cannot be written, or the log cannot be read.
        """
        with self._log.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        self._write({**result, "events": events.events, "events_lost": events.lost, "sha256": digest})

    def _write(self, values: Mapping[str, Any]) -> None:
        self._root.make(FOLDER)
        self._root.write(self.path, json_text({**self._about, **values}).encode("utf-8"))
