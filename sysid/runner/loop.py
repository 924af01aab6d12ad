"""The loop: one turn after the other on absolute deadlines, each of them read → believe → judge → decide → send → record."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.config import STRICT
from sysid.errors import InputError
from sysid.runner.chain import Chain
from sysid.runner.checks.machine import dead_man
from sysid.runner.clock import SECOND
from sysid.runner.cycle import Cycle, Recorder, Verdict
from sysid.runner.histogram import Histogram
from sysid.runner.modes.mode import Goal, Mode
from sysid.runner.operator import WORDS, Operator
from sysid.runner.realtime import on_time
from sysid.runner.senses import Seen, Senses
from sysid.runner.states import States
from sysid.runner.supervisor import Supervisor, at_least, sternest
from sysid.runner.transport import NOBODY, Reading, Transport

Array = npt.NDArray[np.float64]
Ended = Literal["done", "stopped", "fault", "quit", "time"]

#: Where one of these stopped the machine, it is not simply ready again: a person has to look, and reset it.
LATCHING = ("stale", "not_finite", "jump", "frozen", "clock", "contradiction", "motion", "following")
#: Of checks on motion that the runner did not ask for, nothing can be said.
_OWN_MOTION = ("restless", "following", "motion", "frozen")


@dataclass(frozen=True)
class LoopSettings:
    """``[loop]``.

    Args:
        settle_s: everything is sound for so long before the machine counts as ready.
        ready_within_s: unattended runs end where it does not become ready within this.
        rest_s: valves are neutral for so long before a stop counts as done; ``rest_within_s``: else it is a fault.
        seconds: the run ends after so long at the latest; None: never.
        priority: SCHED_FIFO, 1 … 99; 0: none is asked for.
        lock_memory: ask for it.
        fallback: what sets where the policy is not trusted.
    """

    __pydantic_config__ = STRICT

    settle_s: float = 0.5
    ready_within_s: float = 10.0
    rest_s: float = 0.3
    rest_within_s: float = 3.0
    seconds: float | None = None
    priority: int = 50
    lock_memory: bool = True
    fallback: Literal["ik", "hold"] = "ik"


@dataclass
class Outcome:
    """How a run went.

    Args:
        ended: why it is over; ``state``, ``why``: of the machine of states then.
        turns: made; ``missed``: deadlines that passed before their turn began.
        lateness, latency: of all turns.
        verdicts: check → turns in which it objected.
        notes: what the operating system refused, and what the operator was told.
    """

    ended: Ended = "time"
    state: str = "idle"
    why: str = ""
    turns: int = 0
    missed: int = 0
    lateness: Histogram = field(default_factory=Histogram)
    latency: Histogram = field(default_factory=Histogram)
    verdicts: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)


@dataclass
class Decision:
    """What one turn decided; arrays (A,), NaN where nothing was."""

    asked: Array
    setpoints: Array
    drive_setpoints: Array
    commands_asked: Array
    commands: Array
    target: Array
    enabled: bool = False
    source: str = "none"


class Loop:
    """One run of one machine.

    Args:
        transport, chain, senses, supervisor, mode: of the machine and the task.
        recorder: takes every turn.
        operator: arms, stops, resets.
        settings: of the recipe.
        period_s: of a turn.
    """

    def __init__(
        self,
        transport: Transport,
        chain: Chain,
        senses: Senses,
        supervisor: Supervisor,
        mode: Mode,
        recorder: Recorder,
        operator: Operator,
        settings: LoopSettings | None = None,
    ) -> None:
        self.transport, self.chain, self.senses, self.supervisor, self.mode = transport, chain, senses, supervisor, mode
        self.recorder, self.operator, self.settings = recorder, operator, settings or LoopSettings()
        self.dt = 1.0 / chain.plant.machine.rate_hz
        self.period_ns = round(SECOND * self.dt)
        self.states, self.outcome = States(), Outcome()
        self._axes = len(chain.axes)
        self._zero = np.zeros(self._axes)
        self._sound_s, self._neutral_s, self._turn, self._missed = 0.0, 0.0, 0, 0
        self._released, self._fallback, self._thinking = False, False, False
        self._ran, self._leaving, self._wrong, self._latch = False, False, "", ""
        self._sent = self._zero
        self._readings: Mapping[str, Reading] = {}
        self._k = 0
        self._drive_setpoints: Array | None = None
        self._held_at: Array | None = None
        self._line = ""

    def warm_up(self, joints: Array) -> None:
        """Compile and load what the first turns would else wait for; nothing is read or sent."""
        drive = self.chain.controller.drive(joints)[0]
        self.chain.rest(drive, joints)
        ee = self.chain.tip(joints[None])[0]
        self.supervisor.begin(joints)
        for reckoning, place in zip(self.senses.reckonings, drive, strict=True):
            reckoning.reset(float(place))
        seen = self.senses.see({}, NOBODY, 0)
        seen.ee = ee
        self.chain.moved(joints, self._zero)
        self.chain.ask(joints, ee, ee)
        self.chain.solve(joints, ee)
        setpoints, _ = self.supervisor.setpoints(joints + 1e-3)
        _, commands = self.chain.commands(setpoints, drive)
        self.supervisor.look(seen, True, drive)
        self.supervisor.commands(commands + 0.3, seen, self.senses.reckonings)
        self.supervisor.begin(joints)
        self.chain.rest(drive, joints)
        self.senses.reset()

    def run(self, watch: Callable[[Cycle], None] | None = None) -> Outcome:
        """Turn until the task is done, somebody says so, or a fault ends it; the valves are neutral then.

        Args:
            watch: shown every turn, for live views and tests.
        """
        settings, outcome = self.settings, self.outcome
        with on_time(settings.priority, settings.lock_memory) as refused:
            outcome.notes += refused
            for text in refused:
                self.operator.told(text)
            begin = due = self.transport.now_ns() + self.period_ns
            self.states.entered_ns = begin
            try:
                while True:
                    self.transport.wait_until(due)
                    cycle = self._one(due)
                    if watch is not None:
                        watch(cycle)
                    if self._over(cycle.at_ns - begin):
                        break
                    due += self.period_ns
                    late = self.transport.now_ns() - due
                    self._missed = self._missed + 1 if late > 0 else 0
                    skipped = max(0, late) // self.period_ns  # turns that are past are left out, never made up for
                    outcome.missed += skipped + (late > 0)
                    due += skipped * self.period_ns
            finally:
                if self.mode.writes:
                    self._send(self._zero, False)
        outcome.state, outcome.why = self.states.state, self.states.why
        return outcome

    def _one(self, due: int) -> Cycle:
        now = self.transport.now_ns()
        seen = self._see(now, now - due)
        verdicts = self.supervisor.look(seen, self.states.moving, self._drive_setpoints)
        if self.states.state == "running" and not seen.inputs.dead_man:
            verdicts.append(dead_man(self.supervisor.checks))
        if not self.mode.moves:
            verdicts = [verdict for verdict in verdicts if verdict.check not in _OWN_MOTION]
        verdicts = self.supervisor.patience(verdicts)
        self._react(verdicts, now)
        self._listen(seen, verdicts, now)
        self._advance(seen, verdicts, now)
        decision = self._decide(seen, verdicts, now)
        if self.mode.writes and not self._send(decision.commands, decision.enabled):
            self.states.on("fault", now, f"commands cannot be sent: {self._line}")
            decision.enabled = False
        moved = decision.commands if decision.enabled else self._zero
        self.senses.step(moved)
        self._sent = moved
        done = self.transport.now_ns()
        cycle = Cycle(
            self._turn, now, due, self.states.state, seen.inputs, self._readings, seen.joints, seen.ee, decision.target,
            decision.asked, decision.setpoints, decision.drive_setpoints, decision.commands_asked, moved.copy(),
            decision.enabled, tuple(verdicts), decision.source, now - due, done - now,
        )  # fmt: skip
        self.recorder.record(cycle)
        self.outcome.lateness.add(now - due)
        self.outcome.latency.add(done - now)
        self.outcome.verdicts.update({verdict.check for verdict in verdicts})
        self._turn += 1
        self.outcome.turns = self._turn
        return cycle

    def _see(self, now: int, late_ns: int) -> Seen:
        try:
            self._readings, inputs = self.transport.read()
        except OSError as error:
            self._readings = {}
            seen = self.senses.nothing(now, str(error))
        else:
            seen = self.senses.see(self._readings, inputs, now, late_ns / SECOND, self._missed)
        if self._line and not seen.line:
            seen.line = self._line
        seen.recording = self.recorder.fault
        if np.isfinite(seen.joints).all():
            seen.ee = self.chain.tip(seen.joints[None])[0]
            self.chain.moved(seen.joints, self._sent)
        return seen

    def _react(self, verdicts: list[Verdict], now: int) -> None:
        """What is seen decides over the state."""
        worst, state = sternest(verdicts), self.states.state
        if worst is None:
            return
        self._wrong = worst.text
        if worst.reaction == "fault":
            self._tell(self.states.on("fault", now, worst.text))
        elif worst.reaction == "stop" and state == "running":
            self._halt(worst, now)
        elif worst.reaction in ("hold", "stop") and state in ("ready", "armed"):
            self._tell(self.states.on("unhealthy", now, worst.text))

    def _halt(self, verdict: Verdict, now: int) -> None:
        """A verdict stops the machine."""
        if self.states.state == "running" and verdict.check in LATCHING:
            self._latch = verdict.text
        self._tell(self.states.on("stop", now, verdict.text))

    def _listen(self, seen: Seen, verdicts: list[Verdict], now: int) -> None:
        for word in self.operator.words(self.states.state, now):
            if word == "quit":
                self._leave("quit")
                self._tell(self.states.on("stop", now, "the operator quits"))
            elif word not in WORDS:
                self.operator.told(f"{word!r} is none of {', '.join(WORDS)}")
            elif word == "reset" and at_least(verdicts, "fault"):
                self.operator.told(f"not reset while it lasts: {next(v.text for v in verdicts if v.reaction == 'fault')}")
            elif word == "arm" and not self.mode.moves:
                self.operator.told(f"{self.mode.name} moves nothing: there is nothing to arm")
            else:
                try:
                    self.states.demand("stop" if word == "stop" else word, now)  # type: ignore[arg-type]
                except InputError as error:
                    self.operator.told(str(error))
                    continue
                if word == "stop":
                    self.states.why = "the operator says stop"
                if word in ("stop", "disarm") and not self.operator.stays and not self.states.moving:
                    self._leave("stopped")
                if word == "reset":
                    self.senses.reset()
                    self._line = ""
                self._tell(True)

    def _advance(self, seen: Seen, verdicts: list[Verdict], now: int) -> None:
        """What time and switches make of the state."""
        settings, state = self.settings, self.states.state
        sound = not at_least(verdicts, "hold") and bool(np.isfinite(seen.joints).all())
        if state == "idle":
            self._sound_s = self._sound_s + self.dt if sound else 0.0
            if self._sound_s >= settings.settle_s:
                self._tell(self.states.on("healthy", now))
        else:
            self._sound_s = 0.0
        if state in ("ready", "armed") and not seen.inputs.dead_man:
            self._released = True  # a switch that is held all the time, or taped down, does not count
        if state == "armed" and seen.inputs.dead_man and self._released and sound:
            self._released = False
            self._start(seen)
            self._ran = True
            self._tell(self.states.on("hold", now))
        elif state == "ready" and not self.mode.moves and self.mode.thinks and not self._thinking:
            self._start(seen)
            self._thinking = True

    def _start(self, seen: Seen) -> None:
        self.supervisor.begin(seen.joints)
        self.chain.rest(seen.drive, seen.joints)
        self.mode.begin(seen.joints, seen.ee)
        if outside := self.supervisor.beyond(seen):
            self.outcome.notes.append(f"{outside}: only ways back inside are open")
            self.operator.told(self.outcome.notes[-1])
        self._k, self._fallback, self._drive_setpoints, self._neutral_s, self._latch = 0, False, None, 0.0, ""

    def _decide(self, seen: Seen, verdicts: list[Verdict], now: int) -> Decision:
        none = np.full(self._axes, np.nan)
        decision = Decision(none, none, none, none, self._zero.copy(), np.full(3, np.nan))
        if self.states.state == "running" or (self._thinking and np.isfinite(seen.joints).all()):
            self._think(seen, verdicts, decision, now)
        elif self.states.state == "stopping":
            self._slow_down(seen, decision, now)
        if self.states.state != "running" and not self._thinking:
            self._drive_setpoints = None
        return decision

    def _think(self, seen: Seen, verdicts: list[Verdict], decision: Decision, now: int) -> None:
        goal = self.mode.goal(self._k, seen.joints, seen.ee)
        if goal.stop:
            self._end(goal, now)
            if self.states.state == "stopping":
                self._slow_down(seen, decision, now)
            return
        decision.target = goal.target
        held = any(verdict.reaction == "hold" and verdict.check != "policy" for verdict in verdicts)
        if goal.commands is not None and not held:
            decision.source, decision.commands_asked = goal.phase, goal.commands
            self._drive_setpoints = None
            self.supervisor.limiter.reset(seen.joints)
            self.chain.controller.reset(seen.drive)
        else:
            decision.asked, decision.source = self._ask(goal, seen, held, verdicts)
            decision.setpoints, broken = self.supervisor.setpoints(decision.asked)
            verdicts += [] if held else broken  # standing still at once is nobody's wish: it is how a hold begins
            drive_setpoints, decision.commands_asked = self.chain.commands(decision.setpoints, seen.drive)
            decision.drive_setpoints = self._drive_setpoints = drive_setpoints
        decision.commands, broken = self.supervisor.commands(decision.commands_asked, seen, self.senses.reckonings)
        verdicts += broken
        self.chain.took(decision.commands)
        decision.enabled = self.mode.moves
        if not held:
            self._k += 1
        worst = sternest(verdicts)
        if worst is not None and worst.reaction in ("stop", "fault") and self.mode.moves:
            if worst.reaction == "stop":
                self._halt(worst, now)
            else:
                self._tell(self.states.on("fault", now, worst.text))
            decision.enabled = self.states.state != "fault"

    def _ask(self, goal: Goal, seen: Seen, held: bool, verdicts: list[Verdict]) -> tuple[Array, str]:
        """Joint setpoints (A,), and whose they are."""
        here = self.supervisor.limiter.position
        if held:
            return self._hold(here)
        if not self._fallback or (self.settings.fallback == "ik" and self.chain.policy is not None):
            self._held_at = None
        if goal.joints is not None:
            self.chain.solve_from(goal.joints)
            return goal.joints, goal.phase
        error, asked = "", here
        if not self._fallback:
            try:
                asked = self.chain.ask(seen.joints, seen.ee, goal.aim)
            except (ArithmeticError, ValueError, InputError) as problem:
                error = f"the policy fails: {problem}"
            wrong = self.supervisor.policy(asked, error)
            if wrong is None:
                return asked, goal.phase
            verdicts.append(wrong)
            self._fallback = True
            self.chain.solve_from(here)
            self.operator.told(
                f"{wrong.text}: {'inverse kinematics goes on' if self.settings.fallback == 'ik' else 'it holds'}"
            )
        if self.settings.fallback == "hold" or self.chain.policy is None:
            return self._hold(here)
        return self.chain.solve(seen.joints, goal.aim), "fallback"

    def _hold(self, here: Array) -> tuple[Array, str]:
        """Where the hold began: a setpoint that went along with the limiter would keep the speed that it had."""
        if self._held_at is None:
            self._held_at = here.copy()
        return self._held_at.copy(), "hold"

    def _slow_down(self, seen: Seen, decision: Decision, now: int) -> None:
        decision.source = "stop"
        if self.supervisor.barrier.sent.any():
            decision.commands = self.supervisor.ramp(seen, self.senses.reckonings)
            decision.enabled = True
            self._neutral_s = 0.0
            return
        self._neutral_s += self.dt
        still = np.isfinite(seen.drive).all() and bool(seen.measured.all())
        if self._neutral_s >= self.settings.rest_s and self._latch:
            self._tell(self.states.on("fault", now, self._latch))
        elif self._neutral_s >= self.settings.rest_s and still:
            self._tell(self.states.on("rest", now))
        elif self._neutral_s > self.settings.rest_within_s:
            self._tell(self.states.on("fault", now, "nothing says that the machine came to rest"))

    def _end(self, goal: Goal, now: int) -> None:
        self._thinking = False
        if goal.done or not self.mode.moves:
            self._leave("done" if goal.done else "stopped")
        self._tell(self.states.on("stop", now, goal.stop))

    def _send(self, commands: Array, enabled: bool) -> bool:
        try:
            self.transport.write(commands, enabled)
        except OSError as error:
            self._line = str(error) or type(error).__name__
            return False
        return True

    def _leave(self, ended: Ended) -> None:
        """The run is over as soon as nothing moves any more."""
        if not self._leaving:
            self._leaving, self.outcome.ended = True, ended

    def _over(self, elapsed_ns: int) -> bool:
        settings, state = self.settings, self.states.state
        waited_s = (self.transport.now_ns() - self.states.entered_ns) / SECOND
        if not self.operator.stays:
            if state == "fault":  # neutral is said for a while, so that it is heard
                self._leaving, self.outcome.ended = True, "fault"
                return waited_s >= settings.rest_s
            if self._ran and state == "ready":
                self._leave("stopped")
            if state == "idle" and waited_s >= settings.ready_within_s:
                self.states.why = self._wrong or "nothing says that the machine is sound"
                self._leave("stopped")
        if settings.seconds is not None and elapsed_ns >= settings.seconds * SECOND and not self._leaving:
            self._leave("time")
            self._tell(self.states.on("stop", self.transport.now_ns(), f"{settings.seconds:g} s are over"))
        if self._leaving and not self.states.moving:
            if self.states.state == "fault":
                self.outcome.ended = "fault"
            return True
        return False

    def _tell(self, changed: bool) -> None:
        if changed:
            text = f"{self.states.state}" + (f": {self.states.why}" if self.states.why else "")
            self.outcome.notes.append(text)
            self.operator.told(text)
