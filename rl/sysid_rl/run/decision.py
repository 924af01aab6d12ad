"""The decision of a cycle: the goal of the mode, its setpoints, and the commands that the supervisor permits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid_rl.run.chain import ControlChain
from sysid_rl.run.checks.path import PathDistance
from sysid_rl.run.cycle import Violation
from sysid_rl.run.modes.mode import Goal, Mode
from sysid_rl.run.operator import Operator
from sysid_rl.run.policy_thread import PolicyError, error_text
from sysid_rl.run.state_estimator import StateEstimate, StateEstimator
from sysid_rl.run.supervisor import Supervisor
from sysid_rl.run.task_clock import TaskClock

Array = npt.NDArray[np.float64]


@dataclass
class CycleDecision:
    """Arrays (A,), NaN without a decision; ``ended``: the goal that ends the task."""

    requested: Array
    setpoints: Array
    drive_setpoints: Array
    requested_commands: Array
    commands: Array
    target: Array
    enabled: bool = False
    source: str = "none"
    ended: Goal | None = None


def neutral_decision(axes: int) -> CycleDecision:
    """A decision with neutral valves."""
    none = np.full(axes, np.nan)
    return CycleDecision(none, none, none, none, np.zeros(axes), np.full(3, np.nan))


class Decider:
    """The decisions of one run.

    Args:
        chain, estimator, supervisor, mode, operator: of the run.
        fallback: setpoints after the policy was disabled.
        now_ns: clock of the cycles.
    """

    def __init__(
        self,
        chain: ControlChain,
        estimator: StateEstimator,
        supervisor: Supervisor,
        mode: Mode,
        operator: Operator,
        fallback: Literal["ik", "hold"],
        now_ns: Callable[[], int],
    ) -> None:
        self.chain, self.estimator, self.supervisor, self.mode = chain, estimator, supervisor, mode
        self.operator, self.fallback, self._now_ns = operator, fallback, now_ns
        #: Of the cycle before, (A,); None without any.
        self.drive_setpoints: Array | None = None
        self._policy_disabled, self._late = False, 0
        self._held_at: Array | None = None
        self._clock = TaskClock(mode)
        dt = supervisor.dt
        response = dt * max(valve.dead_steps for valve in supervisor.command_filter.valves)
        self._path = PathDistance(supervisor.checks.path, chain.tip, response + chain.lookahead + chain.shaped_s, dt)

    def begin(self, estimate: StateEstimate) -> None:
        """Begin the task with the machine at rest at the estimate."""
        self.supervisor.begin(estimate.joints, estimate.drive)
        if self.mode.name == "commission" or not self.supervisor.checks.on("first_move"):
            self.supervisor.first_move.skip()
        self.chain.rest(estimate.drive, estimate.joints)
        self.mode.begin(estimate.joints, estimate.ee)
        self._clock.begin()
        self._path.begin()
        self._policy_disabled, self._late, self._held_at, self.drive_setpoints = False, 0, None, None

    def decide(self, estimate: StateEstimate, verdicts: list[Violation], until_ns: int) -> CycleDecision:
        """A cycle of the task; violations found in it are appended to ``verdicts``.

        Args:
            until_ns: deadline of a policy.
        """
        decision = neutral_decision(len(self.chain.axes))
        goal = self._clock.goal(estimate.joints, estimate.ee)
        if goal.stop:
            decision.ended = goal
            return decision
        decision.target = goal.target
        held = any(verdict.reaction == "hold" and verdict.check != "policy" for verdict in verdicts)
        if goal.commands is not None and not held:
            decision.source, decision.requested_commands = goal.phase, goal.commands
            self.drive_setpoints = None
            self.supervisor.without_setpoints(estimate.joints)
            self.chain.controller.reset(estimate.drive)
        else:
            decision.requested, decision.source = self._request_setpoints(goal, estimate, held, verdicts, until_ns)
            decision.setpoints, exceeded = self.supervisor.setpoints(decision.requested, estimate.joints)
            verdicts += [] if held else exceeded  # the limits that a hold exceeds at its beginning are no violations
            if decision.source != "hold":
                verdicts += self._path.check(goal, decision.setpoints, estimate.ee)
            drive_setpoints, decision.requested_commands = self.chain.commands(decision.setpoints, estimate.drive)
            decision.drive_setpoints = self.drive_setpoints = drive_setpoints
        decision.commands, exceeded = self.supervisor.commands(
            decision.requested_commands, estimate, self.estimator.dead_reckonings
        )
        verdicts += exceeded
        self.chain.override(decision.commands - self.supervisor.first_move.raised)
        if not held:
            self._clock.advance(self.supervisor.first_move.pace)
        return decision

    def slow_down(self, estimate: StateEstimate) -> CycleDecision:
        """A cycle of a stop; enabled while the last commands are not zero."""
        decision = neutral_decision(len(self.chain.axes))
        decision.source = "stop"
        if self.supervisor.command_filter.sent.any():
            decision.commands = self.supervisor.ramp(estimate, self.estimator.dead_reckonings)
            decision.enabled = True
        return decision

    def _request_setpoints(
        self, goal: Goal, estimate: StateEstimate, held: bool, verdicts: list[Violation], until_ns: int
    ) -> tuple[Array, str]:
        """Joint setpoints (A,) and their source."""
        here = self.supervisor.limiter.position
        if held:
            return self._hold(here)
        if not self._policy_disabled or (self.fallback == "ik" and self.chain.policy is not None):
            self._held_at = None
        if goal.joints is not None:
            self.chain.solve_from(goal.joints)
            return goal.joints, goal.phase
        if not self._policy_disabled:
            requested, wrong = self._ask_policy(goal, estimate, until_ns)
            if wrong is None:
                return requested, goal.phase
            verdicts.append(wrong)
        if self.fallback == "hold" or self.chain.policy is None:
            return self._hold(here)
        try:
            return self.chain.solve(estimate.joints, goal.aim), "fallback"
        except Exception as problem:
            verdicts.append(self.supervisor.no_answer(f"inverse kinematics fails: {error_text(problem)}"))
            return self._hold(here)

    def _ask_policy(self, goal: Goal, estimate: StateEstimate, until_ns: int) -> tuple[Array, Violation | None]:
        """The policy's setpoints, and the violation in them if any.

        A late policy is asked again in the next cycle, until it is late in too many cycles in a row; one that fails is not.
        """
        error, late, here = "", False, self.supervisor.limiter.position
        requested = here
        try:
            requested = self.chain.ask(estimate.joints, estimate.ee, goal.aim, until_ns, self._now_ns)
        except PolicyError as problem:
            error, late = str(problem), problem.late
        except Exception as problem:  # of inverse kinematics, or of the observation
            error = f"no setpoints: {error_text(problem)}"
        self._late = self._late + 1 if late else 0
        if late and self._late < self.supervisor.checks.policy.late_turns:
            self.chain.solve_from(here)
            return here, self.supervisor.no_answer(error, "clamp")
        wrong = self.supervisor.policy(requested, error)
        if wrong is not None:
            self._policy_disabled = True
            self.chain.cancel_policy()
            self.chain.solve_from(here)
            self.operator.notify(f"{wrong.text}: {'inverse kinematics continues' if self.fallback == 'ik' else 'it holds'}")
        return requested, wrong

    def _hold(self, here: Array) -> tuple[Array, str]:
        """The position at the beginning of the hold: a setpoint that follows the limiter would keep its speed."""
        if self._held_at is None:
            self._held_at = here.copy()
        return self._held_at.copy(), "hold"
