"""One run of the runner on the simulated test bench, as a process to pause and kill; `pipelines/runner.py` starts it.

    python pipelines/runner_flight.py RUNNER.toml WORKSPACE [FAULT [TURNS]]

A recipe in mode ``commission`` has its fault, one of :func:`wiring`, from the beginning, and one in mode ``replay`` one of
:func:`first_moves`. Lines on standard output say, on the
monotonic clock, when something changed: ``track``, ``fault``, ``state`` and ``verdict``. Standard input and error are its
terminal, as they are to `sysid run`.
"""

from __future__ import annotations

import ctypes
import json
import resource
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import StorageError, SysidError
from sysid.registry import Registry
from sysid_rl.run.assemble import Assembly, assemble
from sysid_rl.run.chain import ControlChain
from sysid_rl.run.commissioning import digests, record_path, require_commissioned
from sysid_rl.run.cycle import Cycle, State
from sysid_rl.run.faults import (
    BusOff,
    ClockJumped,
    Delayed,
    Fault,
    FaultyTransport,
    Frozen,
    Injection,
    Jumped,
    NotANumber,
    ReadFails,
    Scaled,
    SensorShared,
    Swapped,
    ValveDead,
    ValveShared,
    ValvesSwapped,
    ValveTurned,
)
from sysid_rl.run.first_move import FirstMove as FirstMoveSupervision
from sysid_rl.run.flight_log import FlightLog, provenance
from sysid_rl.run.modes.commission import Commission
from sysid_rl.run.operator import Interruptible, Unattended
from sysid_rl.run.policy_thread import PolicyThread
from sysid_rl.run.recipe import load_runner
from sysid_rl.run.terminal import Console, Terminal, redirected_output
from sysid_rl.run.transports import connect

Array = npt.NDArray[np.float64]

#: Faults come so many cycles after tracking began.
TURNS = 150
SENSOR = "boom.cylinder"
#: What the commands drive.
DRIVEN = ("slew.joint", "boom.cylinder", "stick.cylinder", "telescope.joint")
AXES = tuple(signal.partition(".")[0] for signal in DRIVEN)
#: Between the runner and the bus.
LINE = {
    **{f"frozen {signal}": Frozen(signal) for signal in DRIVEN},
    "delayed by 50 ms": Delayed(0.05),
    "delayed by 200 ms": Delayed(0.2),
    "delayed by 200 ms, unstamped": Delayed(0.2, stamped=False),
    "NaN": NotANumber(SENSOR),
    "jump of 10 mm": Jumped(SENSOR, 0.01),
    "scale error of 20 %": Scaled(SENSOR, 1.2),
    "bus off": BusOff(),
    "line cannot be read": ReadFails(),
    "clock jump of 1 s": ClockJumped(1.0),
}


#: A machine without a wiring fault.
NO_FAULT = "wired right"


def wiring(positions: Mapping[str, float]) -> dict[str, Fault | None]:
    """Faults of the wiring, and none; ``positions``: driven signal → its position at the start [m or rad]."""
    pairs = list(combinations(range(len(DRIVEN)), 2))
    found: dict[str, Fault | None] = {NO_FAULT: None}
    found |= {f"valves of {AXES[a]} and {AXES[b]} swapped": ValvesSwapped(a, b) for a, b in pairs}
    found |= {f"sensors of {AXES[a]} and {AXES[b]} swapped": Swapped(DRIVEN[a], DRIVEN[b]) for a, b in pairs}
    for axis, (name, signal) in enumerate(zip(AXES, DRIVEN, strict=True)):
        found[f"valve of {name} turned"] = ValveTurned(axis)
        found[f"sensor of {name} turned"] = Scaled(signal, -1.0, positions[signal])
        found[f"sensor of {name} × 2"] = Scaled(signal, 2.0, positions[signal])
        found[f"sensor of {name} ÷ 10"] = Scaled(signal, 0.1, positions[signal])
        found[f"zero of {name} {'20 mrad' if name == 'slew' else '20 mm'} off"] = Jumped(signal, 0.02)
    return found


@dataclass(frozen=True)
class FirstMove:
    """A fault of the wiring that came after the commissioning, and the axis that moves first."""

    fault: Fault
    axis: str


def first_moves(positions: Mapping[str, float]) -> dict[str, FirstMove]:
    """Faults of the wiring at the first move; ``positions`` as in :func:`wiring`."""
    known = wiring(positions)
    found = {}
    for name, fault in known.items():
        if isinstance(fault, ValvesSwapped):
            found[name] = FirstMove(fault, AXES[fault.one])
        elif isinstance(fault, Swapped):
            found[name] = FirstMove(fault, fault.one.partition(".")[0])
    for axis, (name, signal) in enumerate(zip(AXES, DRIVEN, strict=True)):
        other = (axis + 1) % len(AXES)
        faults: dict[str, Fault] = {
            f"valve of {name} turned": ValveTurned(axis), f"sensor of {name} turned": Scaled(signal, -1.0, positions[signal]),
            f"valve of {name} dead": ValveDead(axis), f"sensor of {name} dead": Frozen(signal),
            f"sensor of {name} × 2": Scaled(signal, 2.0, positions[signal]),
            f"sensor of {name} ÷ 2": Scaled(signal, 0.5, positions[signal]),
            f"valves of {name} and {AXES[other]} on the message of {name}": ValveShared(axis, other),
            f"valves of {AXES[other]} and {name} on the message of {AXES[other]}": ValveShared(other, axis),
            f"sensor of {name} also for {AXES[other]}": SensorShared(signal, DRIVEN[other]),
            f"sensor of {AXES[other]} also for {name}": SensorShared(DRIVEN[other], signal),
        }  # fmt: skip
        found |= {title: FirstMove(fault, name) for title, fault in faults.items()}
    return found


def _raises(error: Exception) -> Callable[[Array], Any]:
    def act(answer: Array) -> Any:
        raise error

    return act


def _never(answer: Array) -> Any:
    while True:
        pass


def _waits(answer: Array) -> Any:
    threading.Event().wait(3600.0)


#: For which native code keeps the interpreter, once [µs].
_KEPT_US = iter([2_000_000])


def _keeps(answer: Array) -> Any:
    ctypes.PyDLL(None).usleep(next(_KEPT_US, 0))
    return answer


#: A policy that stops the loop.
KEEPS = "policy keeps the interpreter for 2 s"


class _Drifts:
    """Leads the slew away from the path, from one answer to the next by as much as at 0.22 rad/s."""

    def __init__(self) -> None:
        self._away = 0.0

    def __call__(self, answer: Array) -> Any:
        self._away += 0.0022
        answer[:, 0] += self._away
        return answer


DRIFT = "policy drifts smoothly"
#: Of the policy itself: what it makes of its answer.
POLICY: dict[str, Callable[[Array], Any]] = {
    "policy emits NaN": lambda answer: np.full_like(answer, np.nan),
    "policy emits extremes": lambda answer: np.full_like(answer, 1e3),
    "policy raises RuntimeError": _raises(RuntimeError("device lost")),
    "policy raises MemoryError": _raises(MemoryError()),
    "policy answers None": lambda answer: None,
    "policy answers in another shape": lambda answer: answer[:, :2],
    DRIFT: _Drifts(),
    "policy computes for ever": _never,
    "policy waits for ever": _waits,
    KEEPS: _keeps,
}
#: Faults with a long message in every cycle.
LONG_MESSAGES = {"terminal stopped for 2 s (Ctrl-S)", "terminal closed", "standard error closed"}
#: In the runner itself.
LOOP = "exception in the loop"
#: Another runner on the line: it opens it after a line on its standard input.
SECOND_RUNNER = "second"


@dataclass(frozen=True)
class RunSettings:
    """What to fly.

    Args:
        recipe: of the runner; log and outcome go into its folder.
        fault: of ``LINE`` or ``POLICY``, ``LOOP``, ``disk full``, or another one where it comes from outside; of
            :func:`wiring` in a commissioning, of :func:`first_moves` in a replay.
        cycles: it comes so many after the path is followed at its speed.
    """

    recipe: Path
    workspace: Path
    fault: str = ""
    turns: int = TURNS


class AttendedOperator:
    """Arms by program, and has a terminal besides."""

    stays = False

    def __init__(self, program: Unattended, terminal: Terminal) -> None:
        self.program, self.terminal = program, terminal

    def commands(self, state: State, now_ns: int) -> Sequence[str]:
        return [*self.program.commands(state, now_ns), *self.terminal.commands(state, now_ns)]

    def notify(self, text: str) -> None:
        self.terminal.notify(text)


class FaultyPolicy:
    """A policy, or inverse kinematics in its place, whose answers are right until they are not.

    Args:
        chain: whose policy it is.
        wrong: what is made of an answer.
    """

    def __init__(self, chain: ControlChain, wrong: Callable[[Array], Any]) -> None:
        self._chain, self._wrong, self.active = chain, wrong, False
        self._policy = chain.policy
        self._last: Array | None = None
        axes = len(chain.axes)
        self.inputs, self.outputs = chain.view.names, chain.view.names[:axes]
        self._target = slice(axes + 3, axes + 6)

    def act(self, observations: Array) -> Array:
        if self._policy is not None:
            answer = self._policy.act(observations)
        else:
            begin = observations[:, : len(self._chain.axes)] if self._last is None else self._last
            answer, _ = self._chain.inverse.solve(observations[:, self._target], begin)
            self._last = answer
        found: Array = self._wrong(answer.copy()) if self.active else answer.copy()
        return found


def emit(word: str, ns: int, text: str = "") -> None:
    out = sys.__stdout__
    assert out is not None
    out.write(f"{word} {ns} {text}\n")
    out.flush()


class FaultInjection:
    """Writes changes to standard output, and injects the fault."""

    def __init__(
        self,
        settings: RunSettings,
        transport: FaultyTransport,
        policy: FaultyPolicy | None,
        notify: Callable[[str], None],
        first_move: FirstMoveSupervision,
    ) -> None:
        self._first_move = first_move
        self.settings, self.transport, self.policy, self._notify = settings, transport, policy, notify
        self._state, self._checks, self._tracked, self._injected = "", set[tuple[str, str]](), 0, False

    def __call__(self, cycle: Cycle) -> None:
        if cycle.state != self._state:
            self._state = cycle.state
            emit("state", cycle.at_ns, cycle.state)
        for verdict in cycle.verdicts:
            if (verdict.check, verdict.reaction) not in self._checks:
                self._checks.add((verdict.check, verdict.reaction))
                emit("verdict", cycle.at_ns, f"{verdict.check} {verdict.reaction} {verdict.text}")
        at_speed = self._first_move.done and self._first_move.pace >= 1.0
        self._tracked += bool(np.isfinite(cycle.target).all() and at_speed)
        if self._injected and self.settings.fault in LONG_MESSAGES:
            self._notify(200 * "told ")
        if self._tracked == self.settings.turns and not self._injected:
            self._injected = True
            self._checks.clear()
            now = self.transport.now_ns()
            emit("track", now)
            if self.settings.fault:
                emit("fault", now, self.settings.fault)
                self._inject()

    def _inject(self) -> None:
        fault = self.settings.fault
        if fault in LINE:
            self.transport.plan = (Injection(LINE[fault], 0.0),)
            self.transport.start()
        elif self.policy is not None:
            self.policy.active = True
        elif fault == LOOP:
            raise RuntimeError("no way on")
        elif fault == "disk full":
            (log,) = (self.settings.recipe.parent / "logs").glob("*/flight.mcap")
            resource.setrlimit(resource.RLIMIT_FSIZE, (log.stat().st_size + 1000, resource.RLIM_INFINITY))


class CommissioningWatch:
    """Writes the begin of a commissioning to standard output, and passes cycles on to it."""

    def __init__(self, mode: Commission) -> None:
        self._mode, self._begun = mode, False

    def __call__(self, cycle: Cycle) -> None:
        if not self._begun:
            self._begun = True
            emit("fault", cycle.at_ns)
        self._mode.watch(cycle)


def _wired_wrong(assembly: Assembly, fault: str) -> Fault | None:
    """The fault of the wiring from the beginning, if any."""
    recipe = assembly.recipe
    if recipe.mode == "commission":
        return wiring(recipe.commission.reference)[fault]
    return first_moves(recipe.commission.reference)[fault].fault if recipe.mode == "replay" and fault != NO_FAULT else None


def run_once(settings: RunSettings) -> dict[str, Any]:
    folder = settings.recipe.parent
    registry = Registry(settings.workspace)
    assembly = assemble(load_runner(settings.recipe), registry, settings.recipe)
    commissioned, wrong = "", _wired_wrong(assembly, settings.fault)
    plan = (Injection(wrong, 0.0),) if wrong is not None else ()
    if assembly.recipe.mode == "replay":
        if not assembly.recipe.commission.waived:
            record = {"schema": 1, "passed": True, "digests": digests(assembly)}
            record_path(settings.recipe).write_text(json.dumps(record), "utf-8")
        commissioned = require_commissioned(assembly, settings.recipe)
    transport = FaultyTransport(connect(assembly, registry).transport, plan)
    versions = {version.kind: version.reference for version in assembly.loaded.versions}
    words = provenance({"machine": assembly.machine_file, "recipe": settings.recipe}, versions)
    if settings.fault == SECOND_RUNNER:
        sys.stdin.readline()
    log = FlightLog(folder / "logs", assembly.machine_file, transport.axes, transport.signals, words)
    console = Console()
    operator = AttendedOperator(Unattended(transport), Terminal(console))
    with closing(console), Interruptible(operator) as person, redirected_output(console):
        loop = assembly.loop(transport, log, person)
        policy = None
        if settings.fault in POLICY:
            policy = FaultyPolicy(loop.chain, POLICY[settings.fault])
            loop.chain.policy, loop.chain.thread = policy, PolicyThread(policy, len(loop.chain.axes))
        watch: Callable[[Cycle], None] = FaultInjection(
            settings, transport, policy, operator.notify, loop.supervisor.first_move
        )
        if isinstance(loop.mode, Commission):
            watch = CommissioningWatch(loop.mode)
        outcome = loop.run(watch)
        try:
            log.close()
        except StorageError as error:
            outcome.notes.append(str(error))
    return {
        "ended": outcome.ended,
        "state": outcome.state,
        "why": outcome.why,
        "turns": outcome.cycles,
        "missed": outcome.missed,
        "lateness_us": outcome.lateness.to_json(),
        "turn_us": outcome.latency.to_json(),
        "notes": outcome.notes,
        "commissioned": commissioned,
        "versions": versions,
    }


def main(recipe: Path, workspace: Path, fault: str, turns: int) -> int:
    try:
        outcome = run_once(RunSettings(recipe, workspace, fault, turns))
    except SysidError as error:
        outcome = {"ended": "refused", "state": "refused", "why": str(error)}
    (recipe.parent / "outcome.json").write_text(json.dumps(outcome, indent=1) + "\n", "utf-8")
    return 0


if __name__ == "__main__":
    given = dict(enumerate(sys.argv))
    raise SystemExit(main(Path(sys.argv[1]), Path(sys.argv[2]), given.get(3, ""), int(given.get(4, TURNS))))
