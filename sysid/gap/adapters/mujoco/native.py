"""Where an input effect has a native place in an MJCF: delay, filter and gain of the actuator.

Input effects act before everything inside the model, in the order of the catalogue. An effect may move into the actuator if all
that act after it on the same axis move too; a delay moves in any case, since it commutes with time-invariant effects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sysid.effects import CATALOGUE, effect_named
from sysid.machine import KnownEffect
from sysid.machine.sources.mjcf_actuator import Drive
from sysid.machine.sources.mjcf_model import mujoco_library

#: Interpolation of a delayed control between the samples of its history: linear, so that a delay need not be whole steps.
LINEAR = 1


@dataclass(frozen=True)
class Change:
    """An effect that was written into the model, and the attribute that holds it now."""

    effect: KnownEffect
    where: str


def write_native(
    spec: Any, drives: Mapping[str, Drive], effects: Sequence[KnownEffect]
) -> tuple[list[Change], list[KnownEffect]]:
    """Write what has a native place into ``spec``.

    Args:
        drives: axis → its drive, by number of the actuator in ``spec``.

    Returns:
        What was written, and the effects that remain beside the model.
    """
    order = {effect.name: k for k, effect in enumerate(CATALOGUE)}
    written, beside = list[Change](), [item for item in effects if item.target not in drives]
    for axis, drive in drives.items():
        own = sorted((item for item in effects if item.target == axis), key=lambda item: order[item.name])
        actuator, open_end = spec.actuators[drive.actuator], True
        for item in reversed(own):
            writer = WRITERS.get(item.name)
            moves = open_end or item.name == "input_delay"
            place = writer(spec, actuator, drive, item) if writer is not None and moves else None
            if place is not None:
                written.append(Change(item, f"{actuator.name or drive.actuator}: {place}"))
                continue
            beside.append(item)
            open_end = open_end and effect_named(item.name).stage != "command"
    return written, sorted(beside, key=lambda item: order[item.name])


def _delay(spec: Any, actuator: Any, drive: Drive, item: KnownEffect) -> str | None:
    delay = float(actuator.delay) + _value(item, "delay")
    if delay < float(spec.option.timestep):  # between the last two controls MuJoCo takes the older one: a whole step
        return None
    actuator.delay = delay
    actuator.interp = LINEAR
    actuator.nsample = max(int(actuator.nsample), math.ceil(actuator.delay / float(spec.option.timestep)) + 2)
    return f'delay="{actuator.delay:.6g}"'


def _lag(spec: Any, actuator: Any, drive: Drive, item: KnownEffect) -> str | None:
    mujoco = mujoco_library()
    if actuator.dyntype != mujoco.mjtDyn.mjDYN_NONE or actuator.gaintype != mujoco.mjtGain.mjGAIN_FIXED:
        return None
    actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
    actuator.dynprm[0] = _value(item, "time_constant")
    actuator.actearly = True  # otherwise the filter acts a step late, which is a dead time beside the lag
    return f'dyntype="filterexact" dynprm="{actuator.dynprm[0]:.6g}" actearly="true"'


def _gain(spec: Any, actuator: Any, drive: Drive, item: KnownEffect) -> str | None:
    if drive.control != "speed":
        return None
    actuator.gainprm[0] = float(actuator.gainprm[0]) * _value(item, "ratio")
    return f'gainprm="{actuator.gainprm[0]:.6g}"'


def _value(item: KnownEffect, key: str) -> float:
    value = item.parameters[key]
    assert isinstance(value, float)
    return value


#: Effect → writer of its place in an actuator: ``writer(spec, actuator, drive, effect)``, None where the actuator lacks it.
WRITERS: Mapping[str, Callable[[Any, Any, Drive, KnownEffect], str | None]] = {
    "input_delay": _delay,
    "first_order_lag": _lag,
    "gain_error": _gain,
}
