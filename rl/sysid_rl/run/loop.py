"""The control loop with absolute deadlines: read → estimate → check → decide → filter → send → record."""

from __future__ import annotations

import contextlib
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sysid_rl.run.chain import ControlChain
from sysid_rl.run.checks.machine import dead_man
from sysid_rl.run.clock import SECOND
from sysid_rl.run.cycle import Cycle, Recorder, Violation
from sysid_rl.run.decision import CycleDecision, Decider, neutral_decision
from sysid_rl.run.modes.mode import Mode
from sysid_rl.run.operator import Operator
from sysid_rl.run.outcome import RunOutcome
from sysid_rl.run.policy_thread import WARM_UP_S, PolicyError, error_text
from sysid_rl.run.realtime import prioritise_thread, real_time
from sysid_rl.run.recipe import LoopSettings
from sysid_rl.run.state_estimator import StateEstimate, StateEstimator
from sysid_rl.run.state_machine import RunStateMachine
from sysid_rl.run.states import States
from sysid_rl.run.supervisor import Supervisor
from sysid_rl.run.transport import RELEASED_INPUTS, Measurement, Transport

Array = npt.NDArray[np.float64]

#: Checks of the runner's own motion, not evaluated while somebody else moves the machine.
_OWN_MOTION = ("restless", "following", "motion", "frozen")
#: Share of a cycle within which a policy must answer; the rest is for the steps after it.
POLICY_SHARE = 0.6


class Loop:
    """One run of one machine.

    Args:
        transport, chain, estimator, supervisor, mode: of the machine and the task.
        recorder: of every cycle.
        operator: arms, stops, resets.
        settings: of the recipe.
    """

    def __init__(
        self,
        transport: Transport,
        chain: ControlChain,
        estimator: StateEstimator,
        supervisor: Supervisor,
        mode: Mode,
        recorder: Recorder,
        operator: Operator,
        settings: LoopSettings,
    ) -> None:
        self.transport, self.chain, self.estimator, self.supervisor, self.mode = transport, chain, estimator, supervisor, mode
        self.recorder, self.operator, self.settings = recorder, operator, settings
        self.dt = 1.0 / chain.plant.machine.rate_hz
        self.period_ns = round(SECOND * self.dt)
        self.states, self.outcome = States(), RunOutcome()
        self.state_machine = RunStateMachine(self.states, mode, operator, self.settings, self.dt, self.outcome)
        self.decider = Decider(chain, estimator, supervisor, mode, operator, self.settings.fallback, transport.now_ns)
        self._zero = np.zeros(len(chain.axes))
        self._sent = self._zero
        self._readings: Mapping[str, Measurement] = {}
        self._missed = 0
        self._line_error = ""
        #: Time of the last command that let the valves move; None if the last one was neutral.
        self._moved_ns: int | None = None

    def warm_up(self, joints: Array) -> None:
        """Compile and load everything before the first cycle; nothing is read or sent."""
        drive = self.chain.controller.drive(joints)[0]
        self.chain.rest(drive, joints)
        ee = self.chain.tip(joints[None])[0]
        self.supervisor.begin(joints, drive)
        for dead_reckoning, place in zip(self.estimator.dead_reckonings, drive, strict=True):
            dead_reckoning.reset(float(place))
        estimate = self.estimator.update({}, RELEASED_INPUTS, 0)
        estimate.ee = ee
        self.chain.moved(joints, self._zero)
        with contextlib.suppress(PolicyError):  # it occurs again in the run, and the fallback continues
            self.chain.ask(joints, ee, ee, self.transport.now_ns() + round(WARM_UP_S * SECOND), self.transport.now_ns)
        self.chain.solve(joints, ee)
        setpoints, _ = self.supervisor.setpoints(joints + 1e-3, joints)
        _, commands = self.chain.commands(setpoints, drive)
        self.supervisor.check(estimate, True, drive)
        self.supervisor.commands(commands + 0.3, estimate, self.estimator.dead_reckonings)
        self.supervisor.begin(joints, drive)
        self.chain.rest(drive, joints)
        self.estimator.reset()

    def run(self, watch: Callable[[Cycle], None] | None = None) -> RunOutcome:
        """Open the transport, run until the task is done, the operator stops it, or a fault ends it; close it, valves neutral.

        Any error during the run, an interrupt included, is part of the outcome and not an exception.

        Args:
            watch: called with every cycle.

        Raises:
            InputError, SettingsError: the transport cannot be opened.
        """
        settings, outcome = self.settings, self.outcome
        with real_time(settings.priority, settings.lock_memory) as refused:
            for text in refused:
                self.state_machine.note(text)
            if self.chain.thread is not None:
                prioritise_thread(self.chain.thread.native_id, settings.priority)
            try:
                # Last: locking memory takes seconds, in which an unread line would overflow.
                self.transport.open()
                rest_s = 0.0
                try:
                    self._run_cycles(watch)
                except BaseException as error:  # valves go to neutral after any error
                    rest_s = settings.rest_s
                    self._failed(error)
                finally:
                    if self.mode.writes:
                        self._neutral(rest_s)
            finally:
                self.chain.cancel_policy()
                try:
                    self.transport.close()
                except Exception as error:  # a missing line cannot be closed
                    outcome.notes.append(f"the line was not closed: {error_text(error)}")
        if summary := self.supervisor.first_move.summary():
            self.state_machine.note(summary)
        outcome.state, outcome.why = self.states.state, self.states.why
        return outcome

    def _run_cycles(self, watch: Callable[[Cycle], None] | None) -> None:
        begin = due = self.transport.now_ns() + self.period_ns
        self.states.entered_ns = begin
        while True:
            self.transport.wait_until(due)
            cycle = self._run_cycle(due)
            if watch is not None:
                watch(cycle)
            if self.state_machine.is_over(cycle.at_ns - begin, self.transport.now_ns()):
                return
            due += self.period_ns
            late = self.transport.now_ns() - due
            self._missed = self._missed + 1 if late > 0 else 0
            skipped = max(0, late) // self.period_ns  # missed cycles are skipped, not made up for
            self.outcome.missed += skipped + (late > 0)
            due += skipped * self.period_ns

    def _failed(self, error: BaseException) -> None:
        """Record an error of the runner itself: its place in one line, and the traceback in the outcome."""
        self.outcome.error = "".join(traceback.format_exception(error))
        frames = traceback.extract_tb(error.__traceback__)
        place = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
        what = "interrupted" if isinstance(error, KeyboardInterrupt) else f"the runner failed: {error_text(error)}"
        self.state_machine.crashed(what + place, self.transport.now_ns())

    def _neutral(self, seconds: float) -> None:
        """Send the fail-safe state for ``seconds``; if it does not arrive, the machine's own time-out closes the valves."""
        due = self.transport.now_ns()
        for _ in range(1 + round(seconds / self.dt)):
            self._send(self._zero, False)
            due += self.period_ns
            if seconds:
                try:
                    self.transport.wait_until(due)
                except Exception:  # the clock fails: close the line
                    return

    def _run_cycle(self, due: int) -> Cycle:
        now = self.transport.now_ns()
        estimate = self._update_estimate(now, now - due)
        verdicts = self.supervisor.check(estimate, self.states.moving, self.decider.drive_setpoints)
        if self.states.state == "running" and not estimate.inputs.dead_man:
            verdicts.append(dead_man(self.supervisor.checks))
        if not self.mode.moves:
            verdicts = [verdict for verdict in verdicts if verdict.check not in _OWN_MOTION]
        verdicts = self.supervisor.patience(verdicts)
        self.state_machine.react(verdicts, now)
        if self.state_machine.process_commands(verdicts, now):
            self.estimator.reset()
            self._line_error = ""
        if self.state_machine.advance(estimate, verdicts, now):
            self.decider.begin(estimate)
            if outside := self.supervisor.beyond(estimate):
                self.state_machine.note(f"{outside}: only ways back inside are open")
        decision = self._decide(estimate, verdicts, now)
        dropped = False
        if decision.enabled and (expired := self._expired(now)) is not None:
            verdicts.append(expired)
            dropped = self._drop(decision, expired, now)
        if self.mode.writes and not dropped:
            sent = self._send(decision.commands, decision.enabled)
            if sent is None:
                self.state_machine.fault(f"commands cannot be sent: {self._line_error}", now)
                decision.enabled = False
            elif decision.enabled:
                decision.commands = sent
        moved = decision.commands if decision.enabled else self._zero
        self.estimator.step(moved)
        self._sent = moved
        done = self.transport.now_ns()
        cycle = Cycle(
            self.outcome.cycles, now, due, self.states.state, estimate.inputs, self._readings, estimate.joints, estimate.ee,
            decision.target, decision.requested, decision.setpoints, decision.drive_setpoints, decision.requested_commands,
            moved.copy(), decision.enabled, tuple(verdicts), decision.source, now - due, done - now,
        )  # fmt: skip
        self.recorder.record(cycle)
        self.outcome.lateness.add(now - due)
        self.outcome.latency.add(done - now)
        self.outcome.verdicts.update({verdict.check for verdict in verdicts})
        self.outcome.cycles += 1
        return cycle

    def _update_estimate(self, now: int, late_ns: int) -> StateEstimate:
        try:
            self._readings, inputs = self.transport.read()
        except Exception as error:  # any exception of a driver; the fail-safe bits are still sent
            self._readings = {}
            estimate = self.estimator.without_readings(now, error_text(error))
        else:
            estimate = self.estimator.update(self._readings, inputs, now, late_ns / SECOND, self._missed)
        if self._line_error and not estimate.line:
            estimate.line = self._line_error
        estimate.recording = self.recorder.fault
        if np.isfinite(estimate.joints).all():
            estimate.ee = self.chain.tip(estimate.joints[None])[0]
            self.chain.moved(estimate.joints, self._sent)
        return estimate

    def _decide(self, estimate: StateEstimate, verdicts: list[Violation], now: int) -> CycleDecision:
        decision = neutral_decision(len(self._zero))
        if self.states.state == "running" or (self.state_machine.computing and np.isfinite(estimate.joints).all()):
            decision = self.decider.decide(estimate, verdicts, now + round(POLICY_SHARE * self.period_ns))
            if decision.ended is not None:
                self.state_machine.end(decision.ended, now)
                if self.states.state == "stopping":
                    decision = self._slow_down(estimate, now)
            else:
                decision.enabled = self.mode.moves and self.state_machine.allow(verdicts, now)
        elif self.states.state == "stopping":
            decision = self._slow_down(estimate, now)
        if self.states.state != "running" and not self.state_machine.computing:
            self.decider.drive_setpoints = None
        return decision

    def _slow_down(self, estimate: StateEstimate, now: int) -> CycleDecision:
        decision = self.decider.slow_down(estimate)
        self.state_machine.braking(not decision.enabled, estimate, now)
        return decision

    def _expired(self, now: int) -> Violation | None:
        """Whether this cycle, which began at ``now``, is too old to open valves: the last check before sending."""
        then = self.transport.now_ns()
        gap = 0 if self._moved_ns is None else then - self._moved_ns
        return self.supervisor.expired((then - now) / SECOND, gap / SECOND)

    def _drop(self, decision: CycleDecision, expired: Violation, now: int) -> bool:
        """Drop a cycle that is too old; whether nothing is sent, so that the machine keeps its last commands.

        It keeps them until the next cycle, at most for ``checks.expired.gap_s``: smoother than neutral valves.
        """
        if expired.reaction == "fault":
            self.state_machine.fault(expired.text, now)
        still = expired.reaction != "fault" and self._moved_ns is not None
        decision.enabled = still
        decision.commands = self._sent.copy() if still else self._zero
        decision.source = "dropped"
        self.supervisor.dropped(decision.commands)
        self.chain.override(decision.commands)
        return still

    def _send(self, commands: Array, enabled: bool) -> Array | None:
        """Send commands; returns them as the line carries them, None if it fails."""
        begin = self.transport.now_ns()
        try:
            sent = self.transport.write(commands, enabled)
        except Exception as error:  # see _update_estimate
            self._line_error = error_text(error)
            self._moved_ns = None if not enabled else self._moved_ns
            return None
        self._moved_ns = begin if enabled else None
        return sent
