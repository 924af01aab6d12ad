"""One run of the runner on the stand-in machine, as a process that can be paused and killed; `pipelines/runner.py` starts it.

    python pipelines/runner_flight.py RUNNER.toml WORKSPACE [FAULT]

Lines on standard output say, on the monotonic clock, when something changed: ``track``, ``fault``, ``state`` and ``verdict``.
"""

from __future__ import annotations

import json
import resource
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import StorageError, SysidError
from sysid.registry import Registry
from sysid.runner.assemble import assemble
from sysid.runner.chain import Chain
from sysid.runner.cycle import Cycle
from sysid.runner.faults import (
    BusOff,
    ClockJumped,
    Delayed,
    FaultyTransport,
    Frozen,
    Injection,
    Jumped,
    NotANumber,
    Scaled,
)
from sysid.runner.flight_log import FlightLog, provenance
from sysid.runner.operator import Unattended
from sysid.runner.recipe import load_runner
from sysid.runner.transports import connect

#: Faults come so many turns after tracking began.
TURNS = 300
SENSOR = "boom.cylinder"
#: Between the runner and the bus.
LINE = {
    "frozen sensor": Frozen(SENSOR),
    "delayed by 50 ms": Delayed(0.05),
    "delayed by 200 ms": Delayed(0.2),
    "delayed by 200 ms, unstamped": Delayed(0.2, stamped=False),
    "NaN": NotANumber(SENSOR),
    "jump of 10 mm": Jumped(SENSOR, 0.01),
    "scale error of 20 %": Scaled(SENSOR, 1.2),
    "bus off": BusOff(),
    "clock jump of 1 s": ClockJumped(1.0),
}
#: Of the policy itself: what it sets.
POLICY = {"policy emits NaN": float("nan"), "policy emits extremes": 1e3}


@dataclass(frozen=True)
class Flight:
    """What to fly.

    Args:
        recipe: of the runner; log and outcome go into its folder.
        fault: of ``LINE`` or ``POLICY``, ``disk full``, or "" where it comes from outside.
    """

    recipe: Path
    workspace: Path
    fault: str = ""


def say(word: str, ns: int, text: str = "") -> None:
    sys.stdout.write(f"{word} {ns} {text}\n")
    sys.stdout.flush()


class Watch:
    """Says what changes, and lets the fault loose."""

    def __init__(self, flight: Flight, transport: FaultyTransport, chain: Chain) -> None:
        self.flight, self.transport, self.chain = flight, transport, chain
        self._state, self._checks, self._tracked, self._loose = "", set[str](), 0, False

    def __call__(self, cycle: Cycle) -> None:
        if cycle.state != self._state:
            self._state = cycle.state
            say("state", cycle.at_ns, cycle.state)
        for verdict in cycle.verdicts:
            if verdict.check not in self._checks:
                self._checks.add(verdict.check)
                say("verdict", cycle.at_ns, f"{verdict.check} {verdict.reaction} {verdict.text}")
        self._tracked += bool(np.isfinite(cycle.target).all())
        if self._tracked == TURNS and not self._loose:
            self._loose = True
            self._checks.clear()
            now = self.transport.now_ns()
            say("track", now)
            if self.flight.fault:
                self._let_loose()
                say("fault", now, self.flight.fault)

    def _let_loose(self) -> None:
        fault = self.flight.fault
        if fault in LINE:
            self.transport.plan = (Injection(LINE[fault], 0.0),)
            self.transport.start()
        elif fault in POLICY:
            wrong = np.full(len(self.chain.axes), POLICY[fault])
            self.chain.ask = lambda joints, ee, target: wrong.copy()  # type: ignore[method-assign]
        elif fault == "disk full":
            (log,) = (self.flight.recipe.parent / "logs").glob("*/flight.mcap")
            resource.setrlimit(resource.RLIMIT_FSIZE, (log.stat().st_size + 1000, resource.RLIM_INFINITY))


def fly(flight: Flight) -> dict[str, Any]:
    folder = flight.recipe.parent
    registry = Registry(flight.workspace)
    assembly = assemble(load_runner(flight.recipe), registry, flight.recipe)
    transport = FaultyTransport(connect(assembly, registry).transport, ())
    versions = {version.kind: version.reference for version in assembly.loaded.versions}
    words = provenance({"machine": assembly.machine_file, "recipe": flight.recipe}, versions)
    log = FlightLog(folder / "logs", assembly.machine_file, transport.axes, transport.signals, words)
    loop = assembly.loop(transport, log, Unattended(transport))
    outcome = loop.run(Watch(flight, transport, loop.chain))
    try:
        log.close()
    except StorageError as error:
        outcome.notes.append(str(error))
    return {
        "ended": outcome.ended,
        "state": outcome.state,
        "why": outcome.why,
        "turns": outcome.turns,
        "missed": outcome.missed,
        "lateness_us": outcome.lateness.to_json(),
        "turn_us": outcome.latency.to_json(),
        "notes": outcome.notes,
        "versions": versions,
    }


def main(recipe: Path, workspace: Path, fault: str) -> int:
    try:
        outcome = fly(Flight(recipe, workspace, fault))
    except SysidError as error:
        outcome = {"ended": "refused", "state": "refused", "why": str(error)}
    (recipe.parent / "outcome.json").write_text(json.dumps(outcome, indent=1) + "\n", "utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3] if len(sys.argv) > 3 else ""))
