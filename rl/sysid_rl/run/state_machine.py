"""The run state machine: effects of verdicts, operator commands, switches and time, and the end of a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.errors import InputError
from sysid_rl.run.clock import SECOND
from sysid_rl.run.cycle import Violation
from sysid_rl.run.modes.mode import Goal, Mode
from sysid_rl.run.operator import OPERATOR_COMMANDS, Operator
from sysid_rl.run.outcome import Ended, RunOutcome
from sysid_rl.run.recipe import LoopSettings
from sysid_rl.run.state_estimator import StateEstimate
from sysid_rl.run.states import States
from sysid_rl.run.supervisor import at_least, most_severe

#: After a stop by one of these checks a person must look, and reset the machine.
LATCHING = (
    "stale",
    "not_finite",
    "jump",
    "frozen",
    "clock",
    "contradiction",
    "motion",
    "path",
    "delay",
    "following",
    "expired",
)


class RunStateMachine:
    """The state machine of one run.

    Args:
        states: changed only here.
        mode, operator, settings, dt: of the run.
        outcome: receives notes and the reason of the end.
    """

    def __init__(
        self, states: States, mode: Mode, operator: Operator, settings: LoopSettings, dt: float, outcome: RunOutcome
    ) -> None:
        self.states, self.mode, self.operator, self.settings = states, mode, operator, settings
        self.dt, self.outcome = dt, outcome
        #: A task that moves nothing is running.
        self.computing = False
        self._healthy_s, self._neutral_s = 0.0, 0.0
        self._released, self._ran, self._finishing = False, False, False
        self._last_violation, self._latch = "", ""

    def react(self, verdicts: Sequence[Violation], now: int) -> None:
        """Apply the verdicts of a cycle to the state."""
        worst, state = most_severe(verdicts), self.states.state
        if worst is None:
            return
        self._last_violation = worst.text
        if worst.reaction == "fault":
            self.fault(worst.text, now)
        elif worst.reaction == "stop" and state == "running":
            self._halt(worst, now)
        elif worst.reaction in ("hold", "stop") and state in ("ready", "armed"):
            self._announce(self.states.on("unhealthy", now, worst.text))

    def process_commands(self, verdicts: Sequence[Violation], now: int) -> bool:
        """Execute the operator's commands; whether one of them was a reset."""
        reset = False
        for said in self.operator.commands(self.states.state, now):
            word, _, reason = (part.strip() for part in said.partition(":"))
            if word in ("quit", "abort"):
                self._finish("quit")
                if word == "abort":
                    self.fault(reason or "the operator aborts", now)
                elif not self._announce(self.states.on("stop", now, reason or "the operator quits")):
                    self.note(reason or "the operator quits")
            elif word not in OPERATOR_COMMANDS:
                self.operator.notify(f"{word!r} is none of {', '.join(OPERATOR_COMMANDS)}")
            elif word == "reset" and at_least(verdicts, "fault"):
                self.operator.notify(f"not reset while it lasts: {next(v.text for v in verdicts if v.reaction == 'fault')}")
            elif word == "arm" and not self.mode.moves:
                self.operator.notify(f"{self.mode.name} moves nothing: there is nothing to arm")
            else:
                try:
                    self.states.demand("stop" if word == "stop" else word, now)  # type: ignore[arg-type]
                except InputError as error:
                    self.operator.notify(str(error))
                    continue
                if word == "stop":
                    self.states.why = "the operator says stop"
                if word in ("stop", "disarm") and not self.operator.stays and not self.states.moving:
                    self._finish("stopped")
                reset = reset or word == "reset"
                self._announce(True)
        return reset

    def advance(self, estimate: StateEstimate, verdicts: Sequence[Violation], now: int) -> bool:
        """Apply time and switches to the state; whether the task begins now."""
        state = self.states.state
        valid = not at_least(verdicts, "hold") and bool(np.isfinite(estimate.joints).all())
        if state == "idle":
            self._healthy_s = self._healthy_s + self.dt if valid else 0.0
            if self._healthy_s >= self.settings.settle_s:
                self._announce(self.states.on("healthy", now))
        else:
            self._healthy_s = 0.0
        if state in ("ready", "armed") and not estimate.inputs.dead_man:
            self._released = True  # a switch that is always held, or taped down, does not count
        if state == "armed" and estimate.inputs.dead_man and self._released and valid:
            self._released, self._ran = False, True
            self._neutral_s, self._latch = 0.0, ""
            self._announce(self.states.on("hold", now))
            return True
        if state == "ready" and not self.mode.moves and self.mode.computes and not self.computing:
            self.computing = True
            return True
        return False

    def allow(self, verdicts: Sequence[Violation], now: int) -> bool:
        """Whether the valves may move after the verdicts on the cycle's own setpoints and commands."""
        worst = most_severe(verdicts)
        if worst is not None and worst.reaction == "stop":
            self._halt(worst, now)
        elif worst is not None and worst.reaction == "fault":
            self.fault(worst.text, now)
        return self.states.state != "fault"

    def end(self, goal: Goal, now: int) -> None:
        """End the task."""
        self.computing = False
        if goal.done or not self.mode.moves:
            self._finish("done" if goal.done else "stopped")
        self._announce(self.states.on("stop", now, goal.stop))

    def braking(self, neutral: bool, estimate: StateEstimate, now: int) -> None:
        """A cycle of a stop; ``neutral``: the valves are."""
        self._neutral_s = self._neutral_s + self.dt if neutral else 0.0
        still = np.isfinite(estimate.drive).all() and bool(estimate.measured.all())
        if self._neutral_s >= self.settings.rest_s and self._latch:
            self.fault(self._latch, now)
        elif self._neutral_s >= self.settings.rest_s and still:
            self._announce(self.states.on("rest", now))
        elif self._neutral_s > self.settings.rest_within_s:
            self.fault("no sensor confirms that the machine is at rest", now)

    def fault(self, why: str, now: int) -> None:
        self._announce(self.states.on("fault", now, why))

    def is_over(self, elapsed_ns: int, now: int) -> bool:
        """Whether the run is over, ``elapsed_ns`` after its beginning."""
        settings, state = self.settings, self.states.state
        waited_s = (now - self.states.entered_ns) / SECOND
        if not self.operator.stays:
            if state == "fault":  # neutral commands are sent for a while
                self._finishing, self.outcome.ended = True, "fault"
                return waited_s >= settings.rest_s
            if self._ran and state == "ready":
                self._finish("stopped")
            if state == "idle" and waited_s >= settings.ready_within_s:
                self.states.why = self._last_violation or "no sensor confirms that the machine is ready"
                self._finish("stopped")
        if settings.seconds is not None and elapsed_ns >= settings.seconds * SECOND and not self._finishing:
            self._finish("time")
            self._announce(self.states.on("stop", now, f"{settings.seconds:g} s are over"))
        if self._finishing and not self.states.moving:
            if self.states.state != "fault":
                return True
            self.outcome.ended = "fault"
            return waited_s >= settings.rest_s  # see above
        return False

    def crashed(self, why: str, now: int) -> None:
        """End the run after an error of the runner itself."""
        self._finishing, self.outcome.ended = True, "fault"
        self.fault(why, now)

    def note(self, text: str) -> None:
        """Show ``text`` to the operator, and keep it in the outcome."""
        self.outcome.notes.append(text)
        self.operator.notify(text)

    def _halt(self, verdict: Violation, now: int) -> None:
        """Stop the machine because of ``verdict``."""
        if self.states.state == "running" and verdict.check in LATCHING:
            self._latch = verdict.text
        self._announce(self.states.on("stop", now, verdict.text))

    def _finish(self, ended: Ended) -> None:
        """End the run as soon as nothing moves."""
        if not self._finishing:
            self._finishing, self.outcome.ended = True, ended

    def _announce(self, changed: bool) -> bool:
        if changed:
            self.note(f"{self.states.state}" + (f": {self.states.why}" if self.states.why else ""))
        return changed
