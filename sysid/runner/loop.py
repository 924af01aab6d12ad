"""The loop: one turn after the other on absolute deadlines, each of them read → believe → judge → decide → send → record."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing

import numpy as np
import numpy.typing as npt

from sysid.runner.chain import Chain
from sysid.runner.checks.machine import dead_man
from sysid.runner.clock import SECOND
from sysid.runner.conduct import Conduct
from sysid.runner.cycle import Cycle, Recorder, Verdict
from sysid.runner.decision import Decider, Decision, nothing
from sysid.runner.loop_settings import LoopSettings
from sysid.runner.modes.mode import Mode
from sysid.runner.operator import Operator
from sysid.runner.outcome import Outcome
from sysid.runner.realtime import on_time
from sysid.runner.senses import Seen, Senses
from sysid.runner.states import States
from sysid.runner.supervisor import Supervisor
from sysid.runner.transport import NOBODY, Reading, Transport

Array = npt.NDArray[np.float64]

#: Of checks on motion that the runner did not ask for, nothing can be said.
_OWN_MOTION = ("restless", "following", "motion", "frozen")


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
        self.conduct = Conduct(self.states, mode, operator, self.settings, self.dt, self.outcome)
        self.decider = Decider(chain, senses, supervisor, mode, operator, self.settings.fallback)
        self._zero = np.zeros(len(chain.axes))
        self._sent = self._zero
        self._readings: Mapping[str, Reading] = {}
        self._missed = 0
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
        """Open the transport, turn until the task is done, somebody says so, or a fault ends it, and let go, valves neutral.

        Args:
            watch: shown every turn, for live views and tests.

        Raises:
            InputError, SettingsError: the transport cannot be opened.
        """
        settings, outcome = self.settings, self.outcome
        with on_time(settings.priority, settings.lock_memory) as refused, closing(self.transport):
            outcome.notes += refused
            for text in refused:
                self.operator.told(text)
            self.transport.open()  # last: to lock the memory takes seconds, in which a line that nobody reads would overflow
            begin = due = self.transport.now_ns() + self.period_ns
            self.states.entered_ns = begin
            try:
                while True:
                    self.transport.wait_until(due)
                    cycle = self._one(due)
                    if watch is not None:
                        watch(cycle)
                    if self.conduct.over(cycle.at_ns - begin, self.transport.now_ns()):
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
        verdicts = self.supervisor.look(seen, self.states.moving, self.decider.drive_setpoints)
        if self.states.state == "running" and not seen.inputs.dead_man:
            verdicts.append(dead_man(self.supervisor.checks))
        if not self.mode.moves:
            verdicts = [verdict for verdict in verdicts if verdict.check not in _OWN_MOTION]
        verdicts = self.supervisor.patience(verdicts)
        self.conduct.react(verdicts, now)
        if self.conduct.listen(verdicts, now):
            self.senses.reset()
            self._line = ""
        if self.conduct.advance(seen, verdicts, now):
            self.decider.begin(seen)
            if outside := self.supervisor.beyond(seen):
                self.conduct.note(f"{outside}: only ways back inside are open")
        decision = self._decide(seen, verdicts, now)
        if self.mode.writes and not self._send(decision.commands, decision.enabled):
            self.conduct.fault(f"commands cannot be sent: {self._line}", now)
            decision.enabled = False
        moved = decision.commands if decision.enabled else self._zero
        self.senses.step(moved)
        self._sent = moved
        done = self.transport.now_ns()
        cycle = Cycle(
            self.outcome.turns, now, due, self.states.state, seen.inputs, self._readings, seen.joints, seen.ee, decision.target,
            decision.asked, decision.setpoints, decision.drive_setpoints, decision.commands_asked, moved.copy(),
            decision.enabled, tuple(verdicts), decision.source, now - due, done - now,
        )  # fmt: skip
        self.recorder.record(cycle)
        self.outcome.lateness.add(now - due)
        self.outcome.latency.add(done - now)
        self.outcome.verdicts.update({verdict.check for verdict in verdicts})
        self.outcome.turns += 1
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

    def _decide(self, seen: Seen, verdicts: list[Verdict], now: int) -> Decision:
        decision = nothing(len(self._zero))
        if self.states.state == "running" or (self.conduct.thinking and np.isfinite(seen.joints).all()):
            decision = self.decider.think(seen, verdicts)
            if decision.ended is not None:
                self.conduct.end(decision.ended, now)
                if self.states.state == "stopping":
                    decision = self._slow_down(seen, now)
            else:
                decision.enabled = self.mode.moves and self.conduct.allow(verdicts, now)
        elif self.states.state == "stopping":
            decision = self._slow_down(seen, now)
        if self.states.state != "running" and not self.conduct.thinking:
            self.decider.drive_setpoints = None
        return decision

    def _slow_down(self, seen: Seen, now: int) -> Decision:
        decision = self.decider.slow_down(seen)
        self.conduct.slowing(not decision.enabled, seen, now)
        return decision

    def _send(self, commands: Array, enabled: bool) -> bool:
        try:
            self.transport.write(commands, enabled)
        except OSError as error:
            self._line = str(error) or type(error).__name__
            return False
        return True
