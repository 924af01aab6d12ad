"""Checks of single sensors: late, missing, stuck, jumping, not finite, or with a clock jump."""

from __future__ import annotations

import math

from sysid_rl.run.checks.settings import CheckSettings
from sysid_rl.run.cycle import Violation
from sysid_rl.run.state_estimator import Sensor, StateEstimate

#: Repetitions of a value by which it counts as stuck, not as old.
REPEATS = 4


def check_sensors(estimate: StateEstimate, settings: CheckSettings, moving: bool) -> list[Violation]:
    """At most one violation for each sensor, the first that applies."""
    return [verdict for sensor in estimate.sensors if (verdict := _check(sensor, settings, moving)) is not None]


def _check(sensor: Sensor, settings: CheckSettings, moving: bool) -> Violation | None:
    name = sensor.signal
    if sensor.age_s > settings.stale.after_s:
        text = f"{name} is missing" if math.isinf(sensor.age_s) else f"{name} is {1e3 * sensor.age_s:.0f} ms old"
        return Violation("stale", name, settings.stale.reaction, sensor.age_s, settings.stale.after_s, text)
    if not sensor.finite:
        return Violation("not_finite", name, settings.not_finite.reaction, sensor.value, math.nan, f"{name} is no number")
    if settings.on("clock") and sensor.ahead_s > settings.clock.jump_s:
        text = f"the clock of {name} went ahead by {1e3 * sensor.ahead_s:.0f} ms"
        return Violation("clock", name, settings.clock.reaction, sensor.ahead_s, settings.clock.jump_s, text)
    limit = settings.jump.share * sensor.range
    if sensor.jump > limit:
        text = f"{name} jumped by {sensor.jump:.4g}"
        return Violation("jump", name, settings.jump.reaction, sensor.jump, limit, text)
    limit = settings.frozen.seconds * sensor.fastest + sensor.play
    if moving and sensor.driven and sensor.still_since > limit and sensor.repeats >= REPEATS:
        text = f"{name} stays at {sensor.value:.6g} while its axis must have moved by {sensor.still_since:.4g}"
        return Violation("frozen", name, settings.frozen.reaction, sensor.still_since, limit, text)
    return None
