"""The supervisor, independent of policy and mode: checks the state estimate and limits setpoints and commands."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from sysid.machine import TabulatedLinkage
from sysid_rl.run.checks.machine import check_machine
from sysid_rl.run.checks.motion import MotionChecks
from sysid_rl.run.checks.sensors import check_sensors
from sysid_rl.run.checks.settings import CheckSettings
from sysid_rl.run.command_filter import CommandFilter, ExceededLimit, outside
from sysid_rl.run.cycle import REACTIONS, Reaction, Violation
from sysid_rl.run.first_move import FirstMove
from sysid_rl.run.limits import Limits, SetpointLimiter
from sysid_rl.run.response import ResponseMonitor
from sysid_rl.run.response_range import ResponseRange
from sysid_rl.run.state_estimator import StateEstimate
from sysid_rl.run.valves import AxisValve, DeadReckoning

Array = npt.NDArray[np.float64]
Inside = Callable[[StateEstimate], str]

#: Names of the limits in messages.
_WORDS = {
    "position": "position", "speed": "speed", "acceleration": "acceleration", "jerk": "jerk", "command": "valve command",
    "fence": "distance outside the fence",
}  # fmt: skip


class Supervisor:
    """The supervisor of one run.

    Args:
        axes: names, in order.
        limits, valves, linkages, tip, dt: of the machine.
        response, response_range: of the state estimator.
        checks: of the recipe.
        inside: a text about the network that extrapolates; "" if none does.
    """

    def __init__(
        self,
        axes: Sequence[str],
        limits: Limits,
        valves: tuple[AxisValve, ...],
        linkages: Sequence[TabulatedLinkage | None],
        tip: Callable[[Array], Array],
        dt: float,
        response: ResponseMonitor,
        response_range: ResponseRange,
        checks: CheckSettings,
        inside: Inside = lambda estimate: "",
    ) -> None:
        self.axes, self.limits, self.checks, self.dt = tuple(axes), limits, checks, dt
        self.limiter = SetpointLimiter(limits, dt)
        self.command_filter = CommandFilter(limits, valves, linkages, tip, dt)
        self.first_move = FirstMove(self.axes, self.command_filter, checks.first_move, response, response_range)
        self._motion = MotionChecks(self.axes, valves, linkages, dt, response_range, checks, inside)
        self._held_s = 0.0

    def begin(self, joints: Array, drive: Array) -> None:
        """Reset at ``joints`` and ``drive`` (A,), before the valves are enabled."""
        self.first_move.begin(joints, drive)
        self.limiter.reset(joints)
        self.command_filter.reset()
        self._motion.reset()
        self._held_s = 0.0

    def check(self, estimate: StateEstimate, moving: bool, drive_setpoints: Array | None) -> list[Violation]:
        """Violations in the state estimate.

        Args:
            moving: whether the valves may move.
            drive_setpoints: of the cycle before, (A,); None without any.
        """
        found = check_machine(estimate, self.checks)
        found += check_sensors(estimate, self.checks, moving)
        found += self.first_move.check() if moving else []
        return found + self._motion.check(estimate, moving, drive_setpoints)

    def patience(self, verdicts: Sequence[Violation]) -> list[Violation]:
        """``verdicts``, with a stop added if a hold lasts longer than ``patience_s``.

        The hold of a disabled policy does not count: the fallback continues.
        """
        held = [verdict for verdict in verdicts if verdict.reaction == "hold" and verdict.check != "policy"]
        self._held_s = self._held_s + self.dt if held else 0.0
        if held and self._held_s > self.checks.patience_s + 1e-9:
            first = held[0]
            text = f"{first.text}, for longer than {1e3 * self.checks.patience_s:.0f} ms"
            return [*verdicts, Violation(first.check, first.target, "stop", first.found, first.limit, text)]
        return list(verdicts)

    def setpoints(self, requested: Array, joints: Array) -> tuple[Array, list[Violation]]:
        """Limited joint setpoints (A,) for requested ones (A,) at ``joints`` (A,), and violations."""
        first_move = self.first_move
        passed, exceeded = self.limiter.step(requested, first_move.shares)
        # Setpoints of a first move, and those that catch up after it, exceed no limit of the recipe.
        limited = np.zeros(len(passed), dtype=np.bool_)
        limited[[axis for check, axis, *_ in exceeded if check != "position"]] = True
        first_move.follow(self.limiter.wanted, passed, joints, limited)
        return passed, self._verdicts([item for item in exceeded if item[0] == "position" or not first_move.exempt[item[1]]])

    def without_setpoints(self, joints: Array) -> None:
        """A cycle in which the task states commands, at joints (A,)."""
        self.limiter.reset(joints)
        self.first_move.without_setpoints()

    def commands(
        self, requested: Array, estimate: StateEstimate, dead_reckonings: Sequence[DeadReckoning]
    ) -> tuple[Array, list[Violation]]:
        """Permitted commands (A,) for requested ones (A,), and violations."""
        permitted = self.first_move.commands(requested, estimate.joints, estimate.drive)
        passed, exceeded = self.command_filter.filter(permitted, estimate.drive, dead_reckonings)
        return passed, self._verdicts(exceeded)

    def ramp(self, estimate: StateEstimate, dead_reckonings: Sequence[DeadReckoning]) -> Array:
        """Commands of a stop, (A,)."""
        return self.command_filter.ramp(estimate.drive, dead_reckonings)

    def beyond(self, estimate: StateEstimate) -> str:
        """A text about the limit, without margin, that the machine exceeds; "" if none."""
        for name, q, low, high in zip(self.axes, estimate.joints, self.limits.hard_low, self.limits.hard_high, strict=True):
            if not low - 1e-6 <= q <= high + 1e-6:
                return f"{name} is at {q:.4g}, outside {low:.4g} … {high:.4g}"
        low, high = self.limits.hard_fence
        if (
            self.limits.fenced
            and math.isfinite(estimate.ee[0])
            and (left := float(outside(estimate.ee[None], low, high)[0])) > 0.0
        ):
            return f"the end effector is {1e3 * left:.0f} mm outside its fence"
        return ""

    def policy(self, requested: Array, error: str) -> Violation | None:
        """The violation in an answer (A,) of the policy, if any; ``error``: why there is no answer."""
        rule = self.checks.policy
        if error or not np.isfinite(requested).all():
            return self.no_answer(error or "the policy answers with a number that is not finite")
        share = np.abs(requested - self.limiter.position) / (self.limits.hard_high - self.limits.hard_low)
        worst = int(np.argmax(share))
        if share[worst] > rule.share:
            text = f"the policy lets {self.axes[worst]} jump by {100.0 * share[worst]:.0f} % of its range"
            return Violation("policy", self.axes[worst], rule.reaction, float(share[worst]), rule.share, text)
        return None

    def no_answer(self, text: str, reaction: Reaction | None = None) -> Violation:
        """The violation of a cycle without an answer; ``reaction``: by default that of ``checks.policy``."""
        return Violation("policy", "machine", reaction or self.checks.policy.reaction, math.nan, math.nan, text)

    def expired(self, age_s: float, gap_s: float) -> Violation | None:
        """The violation of a command that is too old to be sent, if it is.

        Args:
            age_s: since its readings.
            gap_s: since the last command that let the valves move; 0 if they are neutral.
        """
        rule = self.checks.expired
        if gap_s > rule.gap_s:
            text = f"no command went out for {1e3 * gap_s:.0f} ms, after which a machine closes its valves: they stay closed"
            return Violation("expired", "machine", rule.reaction, gap_s, rule.gap_s, text)
        if age_s > rule.age_s:
            text = f"a command came from readings that were {1e3 * age_s:.0f} ms old by then: it was not sent"
            return Violation("expired", "machine", "hold", age_s, rule.age_s, text)
        return None

    def dropped(self, sent: Array) -> None:
        """The commands of this cycle were not sent: the machine keeps ``sent`` (A,)."""
        self.command_filter.sent = sent.copy()

    def _verdicts(self, exceeded: Sequence[ExceededLimit]) -> list[Violation]:
        verdicts = []
        for check, axis, value, limit in exceeded:
            if not self.checks.on(check):
                continue
            target = self.axes[axis] if axis >= 0 else "ee"
            text = f"{_WORDS[check]} of {target}: {value:.4g}, limit {limit:.4g}"
            verdicts.append(Violation(check, target, self.checks.reaction(check), value, limit, text))
        return verdicts


def most_severe(verdicts: Sequence[Violation]) -> Violation | None:
    """The verdict with the most severe reaction, the first of equals; None without any."""
    return max(verdicts, key=lambda verdict: REACTIONS.index(verdict.reaction), default=None)


def at_least(verdicts: Sequence[Violation], reaction: Reaction) -> bool:
    """Whether any verdict has ``reaction`` or a more severe one."""
    return any(REACTIONS.index(verdict.reaction) >= REACTIONS.index(reaction) for verdict in verdicts)
