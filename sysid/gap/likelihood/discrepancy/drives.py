"""Discrepancies of the drives: speed of a velocity axis, position of a servo, force of a force axis.

A coefficient of one equals what the stage does: its full speed, half its range, its usual force.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy import signal

from sysid.compiled import kernel
from sysid.datasets.recording import Recording
from sysid.gap.likelihood.discrepancy.shapes import (
    SMALL,
    bumps,
    delayed,
    low_pass,
    second_order,
    slope,
    slow_cosines,
    smooth,
    span_of,
    waves,
)
from sysid.plant import Model, gravity_load
from sysid.plant.layout import AT, AXIS_WIDTH
from sysid.plant.link_torque import link_torque

if TYPE_CHECKING:
    from sysid.gap.problem import Problem

Array = npt.NDArray[np.float64]
Make = Callable[[Recording], dict[str, Array]]

#: Time constant of the recent past of a command or a setpoint [s].
PAST = 0.15


def velocity_columns(model: Model, problem: Problem, recordings: Sequence[Recording], theta: Array) -> Make:
    """Command → speed, integrated to the position: flow as a function of command, position, rate, past, time, load, others."""
    axis, i = model.machine.axis(problem.target), model.axis_index(problem.target)
    block = theta[i * AXIS_WIDTH : (i + 1) * AXIS_WIDTH]
    delay, lag, gain = float(block[AT.input_delay]), float(block[AT.first_order_lag]), axis.gain * float(block[AT.gain_error])
    hysteresis, max_rate = float(block[AT.valve_hysteresis]), float(block[AT.command_rate_limit])
    middle, half = span_of(tuple(recordings), axis.driven)
    largest = _largest_load(model, recordings, i)
    others = [name for name in model.machine.axis_names if name != axis.name]

    def columns(recording: Recording) -> dict[str, Array]:
        dt = 1.0 / recording.rate_hz
        u = np.zeros(len(recording))
        _spool(delayed(model.held(recording, axis.name)[0], delay, dt), hysteresis, max_rate * dt, u)
        q = (smooth(recording.values(axis.driven), round(0.2 / dt)) - middle) / half
        rate, slow = np.gradient(u, dt), low_pass(u, PAST, dt)
        time = np.arange(len(u)) * dt

        def flow(parts: Array) -> Array:
            return (np.cumsum(low_pass(gain * parts, lag, dt), axis=0) * dt)[:, :, None]

        size = np.abs(u)
        tangents = np.column_stack([u, size, u * size, u * u, u**3, np.tanh(u / SMALL), np.full(len(u), 0.1)])
        steep = np.tanh(rate / 2.0)
        found = {
            "command": flow(np.hstack([bumps(u), tangents])),
            "position": flow(np.column_stack([waves(q, (1.5, 3.0, 4.5, 7.5)), q, q * q]) * u[:, None]),
            "rate": flow(np.column_stack([steep, steep * size, np.tanh(rate / 0.5)])),
            "past": flow(np.column_stack([np.tanh((u - slow) / 0.1), np.tanh((u - slow) / 0.03), np.sign(u) * (u - slow)])),
            "time": flow(slow_cosines(time) * u[:, None]),
        }
        if largest > 0.0:
            load = _load(model, recording, i) / largest
            found["load"] = flow(np.column_stack([load * size, load * u, load * load * u, load * np.tanh(size / SMALL), load]))
        if others:
            demand = sum(np.abs(model.held(recording, name)[0]) for name in others)
            found["other axes"] = flow(np.column_stack([u * demand, u * demand * demand, u * np.maximum(demand - 0.5, 0.0)]))
        found["reading"] = half * np.column_stack([waves(q, (1.5, 3.0, 6.0, 12.0)), q, q * q])[:, :, None]
        found["direction"] = half * np.column_stack([np.tanh(slow / 0.05), np.tanh(u / SMALL)])[:, :, None]
        return found

    return columns


@kernel
def _spool(u, hysteresis, max_step, out):
    """Position of the spool for a command, after its hysteresis (full width) and at most ``max_step`` per sample."""
    held = u[0] if len(u) else 0.0
    spool = held
    for k in range(len(u)):
        held = min(max(held, u[k] - 0.5 * hysteresis), u[k] + 0.5 * hysteresis)
        spool += min(max(held - spool, -max_step), max_step)
        out[k] = spool


def servo_columns(model: Model, problem: Problem, recordings: Sequence[Recording], theta: Array) -> Make:
    """Setpoint → position: following error as a function of speed, acceleration, direction, past, posture, load, time."""
    axis, i = model.machine.axis(problem.target), model.axis_index(problem.target)
    block = theta[i * AXIS_WIDTH : (i + 1) * AXIS_WIDTH]
    delay, lag = float(block[AT.input_delay]), float(block[AT.first_order_lag])
    time_constant, damping_ratio = block[AT.second_order_lag : AT.second_order_lag + 2]
    middle, half = span_of(tuple(recordings), axis.driven)
    largest = _largest_load(model, recordings, i)
    fastest = _fastest(recordings, axis.driven)

    def columns(recording: Recording) -> dict[str, Array]:
        dt = 1.0 / recording.rate_hz
        u = low_pass(delayed(model.held(recording, axis.name)[0], delay, dt), lag, dt)
        u = second_order(u, time_constant, damping_ratio, dt)
        speed = np.gradient(u, dt) / fastest
        change = np.gradient(smooth(speed, round(0.1 / dt)), dt)
        q = (u - middle) / half
        past = low_pass(speed, PAST, dt)
        time = np.arange(len(u)) * dt
        size = np.abs(speed)
        parts = {
            "speed": [speed, size, speed * size, speed**3, np.tanh(speed / 0.2), low_pass(speed, 0.5, dt)],
            "acceleration": [change, np.tanh(change / 2.0), change * size],
            "direction": [np.tanh(speed / 0.02), np.tanh(past / 0.05), np.tanh(speed / 0.005)],
            "past": [past, np.tanh((speed - past) / 0.1), past * np.abs(past)],
            "position": [*waves(q, (1.5, 3.0, 4.5, 7.5, 12.0)).T, q, q * q],
            "time": [*slow_cosines(time).T, *(slow_cosines(time, 2) * speed[:, None]).T],
        }
        if largest > 0.0:
            load = _load(model, recording, i) / largest
            # What is proportional to the load is a compliance, a candidate of each axis that carries one.
            parts["load"] = [load * load, load * np.tanh(speed / 0.02), load * speed]
        return {name: half * np.column_stack(values)[:, :, None] for name, values in parts.items()}

    return columns


def force_columns(model: Model, problem: Problem, recordings: Sequence[Recording], theta: Array) -> Make:
    """Motion → force: as a function of speed, position, acceleration, distance since a reversal, time and load.

    Every column passes the low-pass filter of the force and is taken on the same rows.
    """
    from sysid.plant.force import force_inputs

    axis = model.machine.axis(problem.target)
    middle, half = span_of(tuple(recordings), axis.driven)
    fastest = _fastest(recordings, axis.driven)
    force = np.concatenate([problem.measured(r)[:, 0] for r in recordings])
    scale = float(np.nanmedian(np.abs(force))) if len(force) else 1.0

    def carried(recording: Recording) -> Array:
        """Torque of the links that the transmission carries; of one kilogram at the tip where masses are not known, (n,)."""
        if model.rigid is None:
            return _load(model, recording, model.axis_index(axis.name))
        return link_torque(model, theta, recording, axis.name).carried

    largest = max((float(np.abs(carried(r)).max(initial=0.0)) for r in recordings), default=0.0)

    def columns(recording: Recording) -> dict[str, Array]:
        inputs = force_inputs(recording, axis, problem.force_filter, problem.rows(recording))
        v = inputs.speed / fastest
        q = (inputs.position - middle) / half
        a = inputs.acceleration / max(float(np.percentile(np.abs(inputs.acceleration), 95)), 1e-12)
        sign = np.sign(v)
        since = _since_reversal(inputs.position, half)
        time = np.arange(len(v)) / recording.rate_hz
        centres = np.array([-0.9, -0.6, -0.35, -0.18, -0.07, 0.07, 0.18, 0.35, 0.6, 0.9])
        parts = {
            "speed": [
                *bumps(v, centres, np.array([0.25, 0.2, 0.14, 0.09, 0.06, 0.06, 0.09, 0.14, 0.2, 0.25]), 0.01).T,
                v, np.abs(v), v * np.abs(v), v**3, sign, np.ones_like(v),
            ],
            # At a standstill friction is not determined, and filters leave narrow features there: a separate variance.
            "standstill": [
                *(sign - np.tanh(v / w) for w in (0.02, 0.05, 0.1)),
                *(np.exp(-((v / w) ** 2)) * part for w in (0.03, 0.1) for part in (np.ones_like(v), a, np.tanh(a / 0.2))),
            ],
            "position": [*waves(q, (1.5, 3.0, 6.0, 12.0)).T, q, q * q],
            "position and direction": [*(waves(q, (1.5, 3.0, 6.0)) * sign[:, None]).T, q * sign],
            "acceleration": [a, a * np.abs(a), a * q, a * q * q, a * sign],
            "distance since a reversal": [sign * np.exp(-since / d) for d in (0.003, 0.01, 0.03, 0.1)],
            "time": [*slow_cosines(time).T, *(slow_cosines(time, 2) * sign[:, None]).T],
        }  # fmt: skip
        load = carried(recording) / max(largest, 1e-12)
        if load.any():
            size = np.abs(load)
            # Friction of every curve over the load, in steps at a tenth and at half of it or saturated, and rising with speed.
            parts["load"] = [
                load,
                size * sign,
                load**2 * sign,
                load * size,
                *(np.minimum(size, k) * sign for k in (0.1, 0.5)),
                size * v,
            ]
        found = {}
        for name, values in parts.items():
            table = signal.sosfiltfilt(inputs.low_pass, np.column_stack(values), axis=0)[inputs.rows]
            found[name] = scale * table[:, :, None]
        return found

    return columns


def _since_reversal(position: Array, half: float) -> Array:
    """Distance since the last change of direction, as a share of half the range, (n,)."""
    out = np.zeros(len(position))
    _distance(np.ascontiguousarray(position), half, out)
    return out


@kernel
def _distance(position, half, out):
    distance, last = 0.0, 0.0
    for k in range(1, len(position)):
        move = position[k] - position[k - 1]
        if move * last < 0.0:
            distance = 0.0
        if move != 0.0:
            last = move
        distance += abs(move)
        out[k] = distance / half


def _load(model: Model, recording: Recording, i: int) -> Array:
    return np.asarray(np.nan_to_num(gravity_load(model.machine, recording)[:, i]))


def _largest_load(model: Model, recordings: Sequence[Recording], i: int) -> float:
    """Largest magnitude of the gravity load that *varies*; zero where it is constant or there is none."""
    parts = [_load(model, r, i) for r in recordings]
    joined = np.concatenate(parts) if parts else np.zeros(1)
    largest = float(np.abs(joined).max(initial=0.0))
    return largest if largest > 0.0 and float(np.ptp(joined)) > 0.02 * largest else 0.0


def _fastest(recordings: Sequence[Recording], name: str) -> float:
    """95th percentile of the speed of a signal while it is measured."""
    parts = [np.abs(slope(r.values(name), 1.0 / r.rate_hz)) for r in recordings]
    joined = np.concatenate(parts) if parts else np.zeros(1)
    return max(float(np.percentile(joined, 95)), 1e-9)
