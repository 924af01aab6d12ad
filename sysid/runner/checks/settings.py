"""``[checks]`` of a recipe: what the supervisor looks at, from where on it objects, and what follows.

A reaction may be made sterner than its default, or milder down to what :data:`MILDEST` allows. A check that may be left out at
all (:data:`OPTIONAL`) is left out by name, with the reason in words; it is printed at every start and stands in the log.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from sysid.config import STRICT
from sysid.errors import SettingsError, nearest
from sysid.runner.cycle import REACTIONS, Reaction

#: A reason that says less is none.
SHORTEST_REASON = 12


@dataclass(frozen=True)
class StaleCheck:
    """No fresh reading for ``after_s``, or one that was measured so much longer ago than usual."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "hold"
    after_s: float = 0.045


@dataclass(frozen=True)
class NotFiniteCheck:
    """A sensor sends what is no number."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "hold"


@dataclass(frozen=True)
class JumpCheck:
    """A reading moved by ``share`` of its range more than the axis can have moved."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "hold"
    share: float = 0.01


@dataclass(frozen=True)
class FrozenValueCheck:
    """A reading stays the same to the last bit while the commands must have moved its axis by ``share`` of the range."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "stop"
    share: float = 0.005


@dataclass(frozen=True)
class ClockCheck:
    """The machine's clock jumps ahead by more than ``jump_s``."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "stop"
    jump_s: float = 0.05


@dataclass(frozen=True)
class ContradictionCheck:
    """A cylinder, through its network, and the joint's own sensor differ by ``share`` of the joint's range for ``for_s``."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "stop"
    share: float = 0.03
    for_s: float = 0.03


@dataclass(frozen=True)
class MotionCheck:
    """Measured and reckoned position differ by what ``seconds`` at top speed make: the machine does not do what it is told."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "stop"
    seconds: float = 0.3


@dataclass(frozen=True)
class DelayCheck:
    """The machine answers commands ``after_s`` later than its plant, by its motion and whatever its stamps say."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "stop"
    after_s: float = 0.08


@dataclass(frozen=True)
class DomainLeftCheck:
    """A network is asked beyond its data for ``for_s``, and the way does not lead back."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "stop"
    for_s: float = 0.2


@dataclass(frozen=True)
class FollowingCheck:
    """A setpoint is further ahead of its axis than ``seconds`` at top speed, for ``for_s``."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "stop"
    seconds: float = 0.5
    for_s: float = 0.2


@dataclass(frozen=True)
class OverrunCheck:
    """A cycle begins ``late_s`` late, or ``turns`` in a row miss their deadline."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "stop"
    late_s: float = 0.08
    turns: int = 5


@dataclass(frozen=True)
class ExpiredCheck:
    """A command is ready only ``age_s`` after the readings that it comes from were taken: it is dropped, and the next cycle has
    the word. ``gap_s`` after the last command that let the valves move none is sent any more: the machine's watchdog may have
    closed them, and nothing opens them again before a person has looked. ``reaction`` is what follows from the latter."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "fault"
    age_s: float = 0.05
    gap_s: float = 0.08


@dataclass(frozen=True)
class PolicyAnswerCheck:
    """The policy fails, answers with what are no setpoints, jumps by ``share`` of a joint's range within a cycle, or is late in
    ``late_turns`` cycles in a row; ``hold`` means that the fallback takes over for the rest of the run. In a single cycle
    that it is late the fallback stands in."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "hold"
    share: float = 0.2
    late_turns: int = 3


@dataclass(frozen=True)
class BoundCheck:
    """A limit of ``[limits]`` that would have been left; what is sent stays within it whatever the reaction."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "clamp"


@dataclass(frozen=True)
class StopCheck:
    """The end effector would leave its fence (it is braked before in any case), the dead-man switch is released, or the log
    cannot be written."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "stop"


@dataclass(frozen=True)
class LatchedCheck:
    """Emergency stop, a fault that the machine reports, a line that is dead."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "fault"


@dataclass(frozen=True)
class RestlessCheck:
    """The machine moves by ``share`` of its top speed, ``after_s`` after its valves were put to neutral."""

    __pydantic_config__ = STRICT
    reaction: Reaction = "fault"
    share: float = 0.15
    after_s: float = 0.6


@dataclass(frozen=True)
class CheckSettings:
    """All checks.

    Args:
        patience_s: a hold that lasts so long becomes a stop.
        without: check that is left out → why.
    """

    __pydantic_config__ = STRICT

    patience_s: float = 0.1
    stale: StaleCheck = field(default_factory=StaleCheck)
    not_finite: NotFiniteCheck = field(default_factory=NotFiniteCheck)
    jump: JumpCheck = field(default_factory=JumpCheck)
    frozen: FrozenValueCheck = field(default_factory=FrozenValueCheck)
    clock: ClockCheck = field(default_factory=ClockCheck)
    contradiction: ContradictionCheck = field(default_factory=ContradictionCheck)
    motion: MotionCheck = field(default_factory=MotionCheck)
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
        """What follows where ``check`` objects."""
        found: Reaction = getattr(self, check).reaction
        return found

    def on(self, check: str) -> bool:
        """Whether it is looked at at all."""
        return check not in self.without


CHECKS: tuple[str, ...] = tuple(item.name for item in fields(CheckSettings) if item.name not in ("patience_s", "without"))
#: No recipe may ask for less.
MILDEST: dict[str, Reaction] = {
    "stale": "hold", "not_finite": "hold", "jump": "hold", "frozen": "stop", "clock": "hold", "contradiction": "stop",
    "motion": "hold", "delay": "stop", "domain": "clamp", "following": "hold", "overrun": "stop", "expired": "fault",
    "policy": "hold", "position": "clamp", "speed": "clamp", "acceleration": "clamp", "jerk": "clamp", "command": "clamp",
    "fence": "clamp", "dead_man": "stop", "emergency": "fault", "machine": "stop", "line": "fault", "restless": "fault",
    "recording": "clamp",
}  # fmt: skip
#: What the machine's own watchdog waits for commands [s] (docs/can.md): the measure of everything that may be late.
WATCHDOG_S = 0.1


@dataclass(frozen=True)
class ThresholdBounds:
    """Of a threshold: above 0 and at most ``most``, in the unit of its key; ``why`` no check means anything beyond."""

    most: float
    why: str


_WATCHED = "the machine closes its valves by itself after 0.1 s without commands"
#: Every threshold of every check.
BOUNDS: dict[str, ThresholdBounds] = {
    "stale.after_s": ThresholdBounds(WATCHDOG_S, _WATCHED),
    "jump.share": ThresholdBounds(
        0.1, "the fastest axis of the demo's crane takes a quarter of a second for so much of its range"
    ),
    "frozen.share": ThresholdBounds(0.05, "an axis whose sensor stands still moves unseen for so much of its range"),
    "clock.jump_s": ThresholdBounds(0.5, "readings pass for newer than they are by as much"),
    "contradiction.share": ThresholdBounds(
        0.2, "two sensors of one axis that differ by a fifth of its range do not measure the same"
    ),
    "contradiction.for_s": ThresholdBounds(0.5, "the machine moves by a wrong sensor for so long"),
    "motion.seconds": ThresholdBounds(1.0, "the fastest axis of the demo's crane crosses 40 % of its range in 1 s, unseen"),
    "delay.after_s": ThresholdBounds(0.2, "a line that is 0.2 s late takes a crane 67 mm off its path (docs/guide/runner.md)"),
    "domain.for_s": ThresholdBounds(2.0, "networks are not to be believed outside of their data"),
    "following.seconds": ThresholdBounds(1.0, "a setpoint that is 1 s at full speed ahead is not followed"),
    "following.for_s": ThresholdBounds(1.0, "the setpoint runs away for so long"),
    "overrun.late_s": ThresholdBounds(WATCHDOG_S, _WATCHED),
    "overrun.turns": ThresholdBounds(10, "ten cycles of 10 ms are what the machine waits for commands"),
    "expired.age_s": ThresholdBounds(
        0.06, "a machine that checks the stamp of a command takes none that answers older readings"
    ),
    "expired.gap_s": ThresholdBounds(0.09, f"{_WATCHED}, within a cycle of 10 ms; a later command would open them again"),
    "policy.share": ThresholdBounds(1.0, "no setpoint can jump by more than the whole range"),
    "policy.late_turns": ThresholdBounds(10, "ten cycles without the policy are what the machine waits for commands"),
    "restless.share": ThresholdBounds(0.5, "half of full speed with neutral valves is a valve that is open"),
    "restless.after_s": ThresholdBounds(2.0, "valves close in a tenth of a second"),
}
#: May be left out, one by one.
OPTIONAL: tuple[str, ...] = ("clock", "contradiction", "motion", "delay", "domain", "following", "jerk")


def check_checks(settings: CheckSettings, where: object) -> CheckSettings:
    """``settings`` unless they ask for less than is allowed.

    Raises:
        SettingsError: a reaction that is too mild, a check left out that must not be, or without a reason; a threshold outside
            of its :data:`BOUNDS`.
    """
    for name in CHECKS:
        rule = getattr(settings, name)
        if REACTIONS.index(rule.reaction) < REACTIONS.index(MILDEST[name]):
            expected = " or ".join(repr(item) for item in REACTIONS[REACTIONS.index(MILDEST[name]) :])
            raise SettingsError(f"{where}: checks.{name}.reaction", repr(rule.reaction), expected)
        for item in fields(rule):
            if item.name != "reaction":
                _check_threshold(f"{name}.{item.name}", getattr(rule, item.name), where)
    if not 0.0 < settings.patience_s <= 1.0:
        raise SettingsError(f"{where}: checks.patience_s", f"{settings.patience_s:g} s", "above 0, at most 1 s")
    for name, reason in settings.without.items():
        if name not in CHECKS:
            raise SettingsError(f"{where}: checks.without", f"unknown check {name!r}", nearest(name, OPTIONAL))
        if name not in OPTIONAL:
            raise SettingsError(f"{where}: checks.without.{name}", "cannot be left out", f"one of: {', '.join(OPTIONAL)}")
        if len(reason.strip()) < SHORTEST_REASON:
            raise SettingsError(f"{where}: checks.without.{name}", f"the reason {reason!r}", "one sentence that says why")
    return settings


def _check_threshold(key: str, value: float, where: object) -> None:
    bounds = BOUNDS[key]
    if not 0.0 < value <= bounds.most:
        raise SettingsError(f"{where}: checks.{key}", f"{value:g}", f"above 0, at most {bounds.most:g}: {bounds.why}")
