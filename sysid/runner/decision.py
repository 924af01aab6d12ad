"""One turn's decision: what the mode wants, whose setpoints those become, and which commands the supervisor lets through."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError
from sysid.runner.chain import Chain
from sysid.runner.cycle import Verdict
from sysid.runner.modes.mode import Goal, Mode
from sysid.runner.operator import Operator
from sysid.runner.senses import Seen, Senses
from sysid.runner.supervisor import Supervisor

Array = npt.NDArray[np.float64]


@dataclass
class Decision:
    """Arrays (A,), NaN where nothing was decided; ``ended``: the goal that says that the task is over."""

    asked: Array
    setpoints: Array
    drive_setpoints: Array
    commands_asked: Array
    commands: Array
    target: Array
    enabled: bool = False
    source: str = "none"
    ended: Goal | None = None


def nothing(axes: int) -> Decision:
    """Neutral valves."""
    none = np.full(axes, np.nan)
    return Decision(none, none, none, none, np.zeros(axes), np.full(3, np.nan))


class Decider:
    """Of one run.

    Args:
        chain, senses, supervisor, mode, operator: of the run.
        fallback: what sets where the policy is not trusted.
    """

    def __init__(
        self,
        chain: Chain,
        senses: Senses,
        supervisor: Supervisor,
        mode: Mode,
        operator: Operator,
        fallback: Literal["ik", "hold"],
    ) -> None:
        self.chain, self.senses, self.supervisor, self.mode = chain, senses, supervisor, mode
        self.operator, self.fallback = operator, fallback
        #: Of the turn before, (A,) of what the commands drive; None where there are none.
        self.drive_setpoints: Array | None = None
        self._k, self._distrusted = 0, False
        self._held_at: Array | None = None

    def begin(self, seen: Seen) -> None:
        """The task starts with the machine at rest where it is seen."""
        self.supervisor.begin(seen.joints)
        self.chain.rest(seen.drive, seen.joints)
        self.mode.begin(seen.joints, seen.ee)
        self._k, self._distrusted, self._held_at, self.drive_setpoints = 0, False, None, None

    def think(self, seen: Seen, verdicts: list[Verdict]) -> Decision:
        """A turn of the task; what the supervisor finds in it is added to ``verdicts``."""
        decision = nothing(len(self.chain.axes))
        goal = self.mode.goal(self._k, seen.joints, seen.ee)
        if goal.stop:
            decision.ended = goal
            return decision
        decision.target = goal.target
        held = any(verdict.reaction == "hold" and verdict.check != "policy" for verdict in verdicts)
        if goal.commands is not None and not held:
            decision.source, decision.commands_asked = goal.phase, goal.commands
            self.drive_setpoints = None
            self.supervisor.limiter.reset(seen.joints)
            self.chain.controller.reset(seen.drive)
        else:
            decision.asked, decision.source = self._ask(goal, seen, held, verdicts)
            decision.setpoints, broken = self.supervisor.setpoints(decision.asked)
            verdicts += [] if held else broken  # standing still at once is nobody's wish: it is how a hold begins
            drive_setpoints, decision.commands_asked = self.chain.commands(decision.setpoints, seen.drive)
            decision.drive_setpoints = self.drive_setpoints = drive_setpoints
        decision.commands, broken = self.supervisor.commands(decision.commands_asked, seen, self.senses.reckonings)
        verdicts += broken
        self.chain.took(decision.commands)
        if not held:
            self._k += 1
        return decision

    def slow_down(self, seen: Seen) -> Decision:
        """A turn of a stop; enabled while there is speed to be taken out."""
        decision = nothing(len(self.chain.axes))
        decision.source = "stop"
        if self.supervisor.barrier.sent.any():
            decision.commands = self.supervisor.ramp(seen, self.senses.reckonings)
            decision.enabled = True
        return decision

    def _ask(self, goal: Goal, seen: Seen, held: bool, verdicts: list[Verdict]) -> tuple[Array, str]:
        """Joint setpoints (A,), and whose they are."""
        here = self.supervisor.limiter.position
        if held:
            return self._hold(here)
        if not self._distrusted or (self.fallback == "ik" and self.chain.policy is not None):
            self._held_at = None
        if goal.joints is not None:
            self.chain.solve_from(goal.joints)
            return goal.joints, goal.phase
        error, asked = "", here
        if not self._distrusted:
            try:
                asked = self.chain.ask(seen.joints, seen.ee, goal.aim)
            except (ArithmeticError, ValueError, InputError) as problem:
                error = f"the policy fails: {problem}"
            wrong = self.supervisor.policy(asked, error)
            if wrong is None:
                return asked, goal.phase
            verdicts.append(wrong)
            self._distrusted = True
            self.chain.solve_from(here)
            self.operator.told(f"{wrong.text}: {'inverse kinematics goes on' if self.fallback == 'ik' else 'it holds'}")
        if self.fallback == "hold" or self.chain.policy is None:
            return self._hold(here)
        return self.chain.solve(seen.joints, goal.aim), "fallback"

    def _hold(self, here: Array) -> tuple[Array, str]:
        """Where the hold began: a setpoint that went along with the limiter would keep the speed that it had."""
        if self._held_at is None:
            self._held_at = here.copy()
        return self._held_at.copy(), "hold"
