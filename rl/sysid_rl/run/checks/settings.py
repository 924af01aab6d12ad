"""``[checks]`` of a recipe: thresholds and reactions of the supervisor's checks.

A reaction may be stricter than its default, or milder down to :data:`MILDEST`. A check in :data:`OPTIONAL` can be disabled by
name with a reason, which is printed at every start and stored in the log.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from sysid.config import Strict
from sysid.errors import SettingsError, nearest
from sysid_rl.run.cycle import REACTIONS, Reaction

#: Shortest accepted reason [characters].
SHORTEST_REASON = 12


@dataclass(frozen=True)
class StaleCheck(Strict):
    """No fresh reading for ``after_s``, or one whose delay exceeds the usual delay by that."""

    reaction: Reaction = "hold"
    after_s: float = 0.045


@dataclass(frozen=True)
class NotFiniteCheck(Strict):
    """A sensor sends NaN or infinity."""

    reaction: Reaction = "hold"


@dataclass(frozen=True)
class JumpCheck(Strict):
    """A reading moved by ``share`` of its range more than the axis can have moved."""

    reaction: Reaction = "hold"
    share: float = 0.01


@dataclass(frozen=True)
class FrozenValueCheck(Strict):
    """A reading stays the same to the last bit while, by its commands, its axis moved for ``seconds`` at top speed beyond its
    play."""

    reaction: Reaction = "stop"
    seconds: float = 0.02


@dataclass(frozen=True)
class ClockCheck(Strict):
    """The machine's clock jumps ahead by more than ``jump_s``."""

    reaction: Reaction = "stop"
    jump_s: float = 0.05


@dataclass(frozen=True)
class ContradictionCheck(Strict):
    """A cylinder, through its network, and the joint's own sensor differ by ``share`` of the joint's range for ``for_s``."""

    reaction: Reaction = "stop"
    share: float = 0.03
    for_s: float = 0.03


@dataclass(frozen=True)
class MotionCheck(Strict):
    """Measured motion leaves the range of responses of machines like the plant by ``seconds`` at top speed.

    Args:
        wider: what dead-bands may be beyond those of the plant's range, for ``first_move`` and ``delay`` too [command].
    """

    reaction: Reaction = "stop"
    seconds: float = 0.015
    wider: float = 0.0


@dataclass(frozen=True)
class FirstMoveCheck(Strict):
    """In its first move after a start, at about ``speed`` at the end effector, an axis does not answer as its plant, or
    another one answers; ``seconds`` as in ``motion``."""

    reaction: Reaction = "fault"
    speed: float = 0.03
    seconds: float = 0.015


@dataclass(frozen=True)
class PathCheck(Strict):
    """The end effector, or the joint setpoints, are farther than ``distance`` [m] from the path of the task."""

    reaction: Reaction = "stop"
    distance: float = 0.03


@dataclass(frozen=True)
class DelayCheck(Strict):
    """The machine answers commands ``after_s`` later than its plant, by its motion, independent of stamps."""

    reaction: Reaction = "stop"
    after_s: float = 0.08


@dataclass(frozen=True)
class DomainLeftCheck(Strict):
    """A network extrapolates for ``for_s``, and the motion does not lead back to its training domain."""

    reaction: Reaction = "stop"
    for_s: float = 0.2


@dataclass(frozen=True)
class FollowingCheck(Strict):
    """A setpoint is ahead of its axis by more than ``seconds`` at top speed, for ``for_s``."""

    reaction: Reaction = "stop"
    seconds: float = 0.5
    for_s: float = 0.2


@dataclass(frozen=True)
class OverrunCheck(Strict):
    """A cycle begins ``late_s`` late, or ``turns`` cycles in a row miss their deadline."""

    reaction: Reaction = "stop"
    late_s: float = 0.08
    turns: int = 5


@dataclass(frozen=True)
class ExpiredCheck(Strict):
    """A command that is ready later than ``age_s`` after its readings is dropped. Later than ``gap_s`` after the last command
    that let the valves move, none is sent any more: the machine's watchdog may have closed them, and no command may open them
    again before a person has looked. ``reaction`` is that of the latter."""

    reaction: Reaction = "fault"
    age_s: float = 0.05
    gap_s: float = 0.08


@dataclass(frozen=True)
class PolicyAnswerCheck(Strict):
    """The policy fails, does not return setpoints, jumps by ``share`` of a joint's range within a cycle, or is late in
    ``late_turns`` cycles in a row. With ``hold`` the fallback continues for the rest of the run; in a single late cycle it
    sets that cycle only."""

    reaction: Reaction = "hold"
    share: float = 0.2
    late_turns: int = 3


@dataclass(frozen=True)
class BoundCheck(Strict):
    """A limit of ``[limits]`` would be exceeded; the output stays within it whatever the reaction."""

    reaction: Reaction = "clamp"


@dataclass(frozen=True)
class StopCheck(Strict):
    """The end effector would leave its fence (it is braked before in any case), the dead-man switch is released, or the log
    cannot be written."""

    reaction: Reaction = "stop"


@dataclass(frozen=True)
class LatchedCheck(Strict):
    """Emergency stop, a fault that the machine reports, a dead line."""

    reaction: Reaction = "fault"


@dataclass(frozen=True)
class RestlessCheck(Strict):
    """An axis moves at ``share`` of its top speed, ``after_s`` after its valve went to neutral."""

    reaction: Reaction = "fault"
    share: float = 0.15
    after_s: float = 0.6


@dataclass(frozen=True)
class CheckSettings(Strict):
    """All checks.

    Args:
        patience_s: a hold of this duration becomes a stop.
        without: disabled check → reason.
    """

    patience_s: float = 0.1
    stale: StaleCheck = field(default_factory=StaleCheck)
    not_finite: NotFiniteCheck = field(default_factory=NotFiniteCheck)
    jump: JumpCheck = field(default_factory=JumpCheck)
    frozen: FrozenValueCheck = field(default_factory=FrozenValueCheck)
    clock: ClockCheck = field(default_factory=ClockCheck)
    contradiction: ContradictionCheck = field(default_factory=ContradictionCheck)
    motion: MotionCheck = field(default_factory=MotionCheck)
    first_move: FirstMoveCheck = field(default_factory=FirstMoveCheck)
    path: PathCheck = field(default_factory=PathCheck)
    delay: DelayCheck = field(default_factory=DelayCheck)
    domain: DomainLeftCheck = field(default_factory=DomainLeftCheck)
    following: FollowingCheck = field(default_factory=FollowingCheck)
    overrun: OverrunCheck = field(default_factory=OverrunCheck)
    expired: ExpiredCheck = field(default_factory=ExpiredCheck)
    policy: PolicyAnswerCheck = field(default_factory=PolicyAnswerCheck)
    position: BoundCheck = field(default_factory=BoundCheck)
    speed: BoundCheck = field(default_factory=BoundCheck)
    acceleration: BoundCheck = field(default_factory=BoundCheck)
    jerk: BoundCheck = field(default_factory=BoundCheck)
    command: BoundCheck = field(default_factory=BoundCheck)
    fence: StopCheck = field(default_factory=StopCheck)
    dead_man: StopCheck = field(default_factory=StopCheck)
    emergency: LatchedCheck = field(default_factory=LatchedCheck)
    machine: LatchedCheck = field(default_factory=LatchedCheck)
    line: LatchedCheck = field(default_factory=LatchedCheck)
    restless: RestlessCheck = field(default_factory=RestlessCheck)
    recording: StopCheck = field(default_factory=StopCheck)
    without: dict[str, str] = field(default_factory=dict)

    def reaction(self, check: str) -> Reaction:
        """The reaction to a violation of ``check``."""
        found: Reaction = getattr(self, check).reaction
        return found

    def on(self, check: str) -> bool:
        """Whether the check is enabled."""
        return check not in self.without


CHECKS: tuple[str, ...] = tuple(item.name for item in fields(CheckSettings) if item.name not in ("patience_s", "without"))
#: Mildest permitted reactions.
MILDEST: dict[str, Reaction] = {
    "stale": "hold", "not_finite": "hold", "jump": "hold", "frozen": "stop", "clock": "hold", "contradiction": "stop",
    "motion": "hold", "first_move": "fault", "path": "stop", "delay": "stop", "domain": "clamp", "following": "hold",
    "overrun": "stop", "expired": "fault",
    "policy": "hold", "position": "clamp", "speed": "clamp", "acceleration": "clamp", "jerk": "clamp", "command": "clamp",
    "fence": "clamp", "dead_man": "stop", "emergency": "fault", "machine": "stop", "line": "fault", "restless": "fault",
    "recording": "clamp",
}  # fmt: skip
#: Time-out of the machine's watchdog [s] (docs/can.md): the reference of all time limits.
WATCHDOG_S = 0.1


@dataclass(frozen=True)
class ThresholdBounds:
    """A threshold is above 0, or also 0 if ``zero``, and at most ``most``, in the unit of its key, for the reason ``why``."""

    most: float
    why: str
    zero: bool = False


_WATCHED = "the machine closes its valves by itself after 0.1 s without commands"
#: Every threshold of every check.
BOUNDS: dict[str, ThresholdBounds] = {
    "stale.after_s": ThresholdBounds(WATCHDOG_S, _WATCHED),
    "jump.share": ThresholdBounds(0.1, "the fastest axis of the demo's crane moves that share of its range in 0.25 s"),
    "frozen.seconds": ThresholdBounds(0.1, "an axis with a stuck sensor moves undetected for that time"),
    "clock.jump_s": ThresholdBounds(0.5, "readings count as newer than they are by that time"),
    "contradiction.share": ThresholdBounds(
        0.2, "two sensors of one axis that differ by a fifth of its range do not measure the same"
    ),
    "contradiction.for_s": ThresholdBounds(0.5, "the machine moves with a wrong sensor for that time"),
    "motion.seconds": ThresholdBounds(0.3, "an axis that does not obey moves for that time at full speed"),
    "motion.wider": ThresholdBounds(0.5, "small excavators have dead-bands up to 0.67 (docs/machine-facts.md)", zero=True),
    "first_move.speed": ThresholdBounds(0.05, "that is how fast an axis with reversed valve or sensor moves the end effector"),
    "first_move.seconds": ThresholdBounds(0.05, "an axis that answers another command moves for that time at full speed"),
    "path.distance": ThresholdBounds(0.1, "the end effector leaves its path by that distance before it stops"),
    "delay.after_s": ThresholdBounds(0.2, "a line that is 0.2 s late takes a crane 67 mm off its path (docs/guide/runner.md)"),
    "domain.for_s": ThresholdBounds(2.0, "networks are not reliable outside of their training data"),
    "following.seconds": ThresholdBounds(1.0, "a setpoint 1 s ahead at full speed is not followed"),
    "following.for_s": ThresholdBounds(1.0, "the setpoint moves ahead for that time"),
    "overrun.late_s": ThresholdBounds(WATCHDOG_S, _WATCHED),
    "overrun.turns": ThresholdBounds(10, "ten cycles of 10 ms are the machine's time-out for commands"),
    "expired.age_s": ThresholdBounds(0.06, "a machine that checks stamps ignores commands that answer older readings"),
    "expired.gap_s": ThresholdBounds(0.09, f"{_WATCHED}, less a cycle of 10 ms; a later command would open them again"),
    "policy.share": ThresholdBounds(1.0, "no setpoint can jump by more than the whole range"),
    "policy.late_turns": ThresholdBounds(10, "ten cycles without the policy are the machine's time-out for commands"),
    "restless.share": ThresholdBounds(0.5, "half of full speed with neutral valves means an open valve"),
    "restless.after_s": ThresholdBounds(2.0, "valves close in a tenth of a second"),
}
#: Checks that can be disabled, one by one.
OPTIONAL: tuple[str, ...] = ("clock", "contradiction", "motion", "first_move", "delay", "domain", "following", "jerk")


def check_checks(settings: CheckSettings, where: object) -> CheckSettings:
    """``settings``, if reactions, thresholds and disabled checks are permitted.

    Raises:
        SettingsError: a reaction below :data:`MILDEST`, a disabled check that is not :data:`OPTIONAL` or has no reason, a
            threshold outside :data:`BOUNDS`.
    """
    for name in CHECKS:
        rule = getattr(settings, name)
        if REACTIONS.index(rule.reaction) < REACTIONS.index(MILDEST[name]):
            expected = " or ".join(repr(item) for item in REACTIONS[REACTIONS.index(MILDEST[name]) :])
            raise SettingsError(f"{where}: checks.{name}.reaction", repr(rule.reaction), expected)
        for item in fields(rule):
            if item.name == "reaction":
                continue
            key, value = f"{name}.{item.name}", getattr(rule, item.name)
            bounds = BOUNDS[key]
            if not (0.0 < value <= bounds.most or (bounds.zero and value == 0.0)):
                expected = f"{'at least' if bounds.zero else 'above'} 0, at most {bounds.most:g}: {bounds.why}"
                raise SettingsError(f"{where}: checks.{key}", f"{value:g}", expected)
    if not 0.0 < settings.patience_s <= 1.0:
        raise SettingsError(f"{where}: checks.patience_s", f"{settings.patience_s:g} s", "above 0, at most 1 s")
    for name, reason in settings.without.items():
        if name not in CHECKS:
            raise SettingsError(f"{where}: checks.without", f"unknown check {name!r}", nearest(name, OPTIONAL))
        if name not in OPTIONAL:
            raise SettingsError(f"{where}: checks.without.{name}", "cannot be disabled", f"one of: {', '.join(OPTIONAL)}")
        if len(reason.strip()) < SHORTEST_REASON:
            raise SettingsError(f"{where}: checks.without.{name}", f"the reason {reason!r}", "one sentence with the reason")
    return settings
