"""The flat vectors of a compiled plant: the index of every number.

``theta = [axis 0 | axis 1 | … | machine | base | tool | signal 0 | signal 1 | …]``; every axis and every signal has the same
block of slots, neutral values mean "absent". An effect that may sit on two sides has one set of slots for each. The state of
an axis is one flat row as well, in which NaN means "not begun".

Compiled code takes indices from ``AT`` (inside a block of ``theta``) and ``STATE`` (inside the state of an axis): named tuples
of numbers that the compiler treats as constants. An effect on one side of two is ``<name>_<side>`` there.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects import CATALOGUE, Effect, effect_named, input_delay
from sysid.effects.described import side_of
from sysid.effects.effect import TargetKind
from sysid.errors import SettingsError, nearest
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]
Key = tuple[str, str | None, str]
#: Stream (file stem) → its signals, on which a clock effect acts.
Streams = Mapping[str, tuple[str, ...]]


def _block(*kinds: TargetKind) -> dict[Key, tuple[int, float]]:
    """(effect, side, slot) → (place in the block, neutral value)."""
    block: dict[Key, tuple[int, float]] = {}
    for effect in CATALOGUE:
        if effect.target in kinds:
            for side in effect.sides or (None,):
                for slot in effect.slots:
                    block[effect.name, side, slot.name] = (len(block), slot.neutral)
    return block


_AXIS, _MACHINE, _BASE, _TOOL = _block("axis"), _block("machine"), _block("base", "ee"), _block("tool")
_SIGNAL = _block("signal", "stream")
AXIS_WIDTH, SIGNAL_WIDTH = len(_AXIS), len(_SIGNAL)


def _label(effect: str, side: str | None) -> str:
    return effect if side is None else f"{effect}_{side}"


def _places() -> dict[str, int]:
    found: dict[str, int] = {}
    for block in (_AXIS, _MACHINE, _BASE, _TOOL, _SIGNAL):
        for (effect, side, _), (place, _) in block.items():
            found.setdefault(_label(effect, side), place)
    return found


def _states() -> dict[str, int]:
    """Position, speed and an estimated first setpoint, then each effect's; the delay's ring, of variable length, is last."""
    found, count = {"position": 0, "speed": 1, "setpoint": 2}, 3
    for effect in CATALOGUE:
        if effect.target == "axis" and effect is not input_delay.EFFECT:
            for side in effect.sides or (None,):
                if effect.memory(1.0):
                    found[_label(effect.name, side)] = count
                    count += effect.memory(1.0)
    return {**found, input_delay.EFFECT.name: count}


AT: Any = namedtuple("AT", _places())(**_places())
STATE: Any = namedtuple("STATE", _states())(**_states())


def axis_places() -> dict[str, int]:
    """``effect[.side].slot`` → its place in the block of an axis, for all places of the block."""
    return {".".join(filter(None, key)): place for key, (place, _) in _AXIS.items()}


def axis_memory(dt: float) -> int:
    """State values of one axis."""
    return int(STATE.input_delay) + input_delay.EFFECT.memory(dt)


def signals_of(axis_names: Sequence[str]) -> tuple[str, ...]:
    """Signals that a sensor can measure, in the order of their blocks."""
    axes = (axis_signal(name, kind) for name in axis_names for kind in ("cylinder", "joint"))
    speeds = (axis_signal(name, "speed") for name in axis_names)
    return (*axes, *point_signals("ee"), *point_signals("tool"), *speeds)


def machine_place(axes: int) -> int:
    return axes * AXIS_WIDTH


def base_place(axes: int) -> int:
    return machine_place(axes) + len(_MACHINE)


def tool_place(axes: int) -> int:
    return base_place(axes) + len(_BASE)


@cache
def signal_place(axis_names: tuple[str, ...], signal: str) -> int:
    """Index at which the block of a signal begins."""
    return tool_place(len(axis_names)) + len(_TOOL) + signals_of(axis_names).index(signal) * SIGNAL_WIDTH


@cache
def neutral_vector(axes: int) -> Array:
    """``theta`` of a plant without any effect, read-only and cached."""
    axis, signal = ([neutral for _, neutral in block.values()] for block in (_AXIS, _SIGNAL))
    rest = [neutral for block in (_MACHINE, _BASE, _TOOL) for _, neutral in block.values()]
    neutral = np.array(axis * axes + rest + signal * (3 * axes + 6))
    neutral.setflags(write=False)
    return neutral


def slot_indices(
    axis_names: Sequence[str], effect: Effect, target: str, side: str | None, slot: str, streams: Streams | None = None
) -> list[int]:
    """Indices of a slot in ``theta``: one, or one for each signal of a stream.

    Raises:
        SettingsError: the target does not exist, or the side does not fit the effect.
    """
    where = f"effect {effect.name}"
    side = side_of(effect, side)
    if effect.target in ("axis", "signal", "stream"):
        valid = {"axis": axis_names, "signal": signals_of(axis_names), "stream": tuple(streams or ())}[effect.target]
        if target not in valid:
            raise SettingsError(where, f"unknown target {target!r}", nearest(target, valid) if valid else "no stream is known")
    elif target != effect.target:
        raise SettingsError(where, f"target {target!r}", repr(effect.target))
    axes = len(axis_names)
    if effect.target == "axis":
        return [list(axis_names).index(target) * AXIS_WIDTH + _AXIS[effect.name, side, slot][0]]
    if effect.target == "machine":
        return [machine_place(axes) + _MACHINE[effect.name, side, slot][0]]
    if effect.target in ("base", "ee"):
        return [base_place(axes) + _BASE[effect.name, side, slot][0]]
    if effect.target == "tool":
        return [tool_place(axes) + _TOOL[effect.name, side, slot][0]]
    read = signals_of(axis_names)
    carried = (target,) if effect.target == "signal" else [s for s in (streams or {})[target] if s in read]
    return [signal_place(tuple(axis_names), signal) + _SIGNAL[effect.name, side, slot][0] for signal in carried]


def parameter_indices(
    axis_names: Sequence[str],
    effect_name: str,
    target: str,
    side: str | None,
    parameter: str,
    streams: Streams | None = None,
) -> list[list[int]]:
    """For each component of a public parameter, the indices in ``theta`` that take its value."""
    effect = effect_named(effect_name)
    for form in effect.forms:
        for candidate in form.parameters:
            if candidate.name == parameter:
                return [
                    [place for slot in group for place in slot_indices(axis_names, effect, target, side, slot, streams)]
                    for group in candidate.components
                ]
    valid = [name for form in effect.forms for name in form.names]
    raise SettingsError(f"effect {effect_name}", f"unknown parameter {parameter!r}", nearest(parameter, valid))
