"""Input and output effects of a simulator, compiled: effects on its commands, and effects on the driven signal it returns."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.compiled import kernel
from sysid.datasets.recording import Recording
from sysid.effects import CATALOGUE
from sysid.plant import chain, layout
from sysid.plant.axis_loop import begin
from sysid.plant.layout import AT, AXIS_WIDTH, STATE
from sysid.plant.level import first_motion
from sysid.plant.machine_arrays import GAIN, KIND, VELOCITY, MachineArrays
from sysid.plant.model import SETTLE_WINDOW, START_WINDOW, Model
from sysid.plant.stretches import held
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]
Stretches = npt.NDArray[np.int64]


@kernel
def input_effects_of_axis(
    p: Array, rig: MachineArrays, i: int, command: Array, load: Array, stretches: Stretches, dt: float, size: int, out: Array
) -> None:
    """Command (n,) → command after the effects of the command stage (n,), in the unit of the command.

    For a velocity axis this is the demanded speed over the nominal gain, so that effects on the speed act on the command that
    produces it. For a servo axis it is the demanded position.
    """
    s, m = np.empty(size), np.int64(0)
    scale = rig.axes[i, GAIN] if rig.axes[i, KIND] == VELOCITY else 1.0
    for row in range(len(stretches)):
        begin(s, m, size, 0.0, 0.0, np.nan, p, i * AXIS_WIDTH, stretches[row, 0], dt)
        for k in range(stretches[row, 0], stretches[row, 1]):
            out[k] = chain.demand(command[k], p, s, m, size, rig.axes, i, load[k], dt) / scale


@kernel
def output_effects_of_axis(p: Array, i: int, drive: Array, start: float, load: Array, out: Array) -> None:
    """Drive (n,) → joint after backlash and compliance (n,); the backlash begins at ``start``. NaN stays NaN."""
    s = np.full(STATE.input_delay, np.nan)
    s[STATE.backlash_drive] = start
    for k in range(len(drive)):
        if np.isnan(drive[k]):
            out[k] = np.nan
        else:
            out[k] = chain.joint_stage(drive[k], p, i * AXIS_WIDTH, s, np.int64(0), load[k])


def apply_input_effects(
    model: Model, thetas: Array, recording: Recording, axes: Sequence[str], stretches: Stretches
) -> dict[str, Array]:
    """Commands of ``axes`` after the input effects of each of ``thetas``: axis → (lanes, n).

    The load is that at the measured joints. Where the demanded flow of all velocity axes exceeds the pump limit, all of
    them are slowed by the same factor. Lanes without any effect get the command itself, bit by bit.
    """
    place = model.arrays.machine + AT.pump_flow_limit
    limit = thetas[:, place, None]
    if (limit >= layout.neutral_vector(model.axes)[place]).all():
        return {axis: _axis_input_effects(model, thetas, recording, axis, stretches) for axis in axes}
    pumped = [axis.name for axis in model.machine.axes if axis.actuation == "velocity"]
    wanted = {axis: _axis_input_effects(model, thetas, recording, axis, stretches) for axis in dict.fromkeys((*axes, *pumped))}
    demand = np.sum([np.abs(wanted[axis]) for axis in pumped], axis=0)
    share = np.minimum(1.0, limit / np.maximum(demand, 1e-12))
    return {axis: wanted[axis] * share if axis in pumped else wanted[axis] for axis in axes}


def _axis_input_effects(model: Model, thetas: Array, recording: Recording, axis: str, stretches: Stretches) -> Array:
    """Command after the effects of the axis itself, (lanes, n)."""
    i, dt = model.axis_index(axis), 1.0 / recording.rate_hz
    command = held(recording.values(axis_signal(axis, "command")), recording.rate_hz)[0]
    load = model.load(thetas, recording)[i]
    places = _command_places(model.machine.axis_names, axis)
    neutral = layout.neutral_vector(model.axes)[places]
    out = np.repeat(command[None], len(thetas), axis=0)
    for k in np.flatnonzero((thetas[:, places] != neutral).any(axis=1)):
        input_effects_of_axis(thetas[k], model.arrays, i, command, load, stretches, dt, layout.axis_memory(dt), out[k])
    return out


def apply_output_effects(
    model: Model, thetas: Array, drive: Array, measured: Array, load: Array, axis: str, stretches: Stretches, rate_hz: float
) -> Array:
    """Simulated drive (lanes, n) → the signal that the command drives, before its sensor, (lanes, n).

    Every stretch of a velocity axis is shifted as a whole, so that the median of (measured − simulated) over its first 0.2 s is
    zero (the simulator starts from its own state). With backlash, the initial side is the one that fits the first seconds best.
    """
    i, about = model.axis_index(axis), model.machine.axis(axis)
    backlash_at, compliance_at = (i * AXIS_WIDTH + at for at in (AT.backlash_drive, AT.joint_compliance_drive))
    window, settle = max(3, round(START_WINDOW * rate_hz)), round(SETTLE_WINDOW * rate_hz)
    out = np.full(drive.shape, np.nan)
    for k, theta in enumerate(thetas):
        half = 0.5 * theta[backlash_at] if about.drives == "joint" else 0.0
        plain = half <= 0.0 and (theta[compliance_at] == 0.0 or about.drives == "cylinder")

        def drive_to_joint(x: Array, start: float, rows: slice, theta: Array = theta, plain: bool = plain) -> Array:
            if plain:
                return x
            y = np.empty(len(x))
            output_effects_of_axis(theta, i, x, start, load[rows], y)
            return y

        for first, last in stretches:
            rows = slice(int(first), int(last))
            x, seen = drive[k, rows], measured[rows]
            if about.actuation == "position":
                out[k, rows] = drive_to_joint(x, _median(seen[:window]), rows)
                continue
            x = x + _median((seen - drive_to_joint(x, np.nan, rows))[:window], 0.0)
            middle = _median(x[:1])
            if half > 0.0:
                far = first_motion(seen, 0, len(seen)) + settle
                errors = [seen[:far] - drive_to_joint(x[:far] + side * half, middle, rows) for side in (-1, 0, 1)]
                x = x + half * _initial_side([float(np.nansum(error**2)) for error in errors])
            out[k, rows] = drive_to_joint(x, middle, rows)
    return out


def _initial_side(costs: list[float]) -> float:
    """Minimum within [−1, 1] of the parabola through the costs at −1, 0 and 1."""
    low, middle, high = costs
    bend = low - 2.0 * middle + high
    if bend > 0.0:
        return float(np.clip(0.5 * (low - high) / bend, -1.0, 1.0))
    return float(np.sign(low - high))


def _median(values: Array, default: float = float("nan")) -> float:
    there = values[~np.isnan(values)]
    return float(np.median(there)) if len(there) else default


@functools.cache
def _command_places(axis_names: tuple[str, ...], axis: str) -> list[int]:
    """Indices in ``theta`` of the command-stage effects of an axis."""
    effects = [effect for effect in CATALOGUE if effect.stage == "command" and effect.target == "axis"]
    return [
        place
        for effect in effects
        for slot in effect.slots
        for place in layout.slot_indices(axis_names, effect, axis, None, slot.name)
    ]
