"""Slow reference integrations, written in plain Python and SciPy from the contract's definitions and nothing else.

Commands are held over a step. Velocity axes are integrated in ``PARTS`` sub-steps; forces and pendulum by an adaptive solver.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

Array = npt.NDArray[np.float64]
PARTS = 100
GRAVITY = 9.80665


def velocity_axis(
    command: Array,
    dt: float,
    gain: float,
    begin: float,
    load: Array | None = None,
    sticking_spool: tuple[float, float] = (0.0, 0.0),
    **effects: Sequence[float],
) -> Array:
    """Position of a velocity axis at the samples; effects by name with their parameters in the contract's order.

    ``load`` (n,) is the gravity moment at the samples, held over each step. ``sticking_spool``: command beyond the smaller
    overlap that frees the spool, and the opening below which it sticks.
    """
    h = dt / PARTS
    delay = effects.get("input_delay", (0.0,))[0]
    play = effects.get("valve_hysteresis", (0.0,))[0]
    dead = effects.get("valve_deadband", (0.0, 0.0))
    exponent = effects.get("gain_curve", (1.0,))[0]
    limit = effects.get("flow_saturation", (math.inf,))[0]
    rate = effects.get("command_rate_limit", (math.inf,))[0]
    lag = effects.get("first_order_lag", (0.0,))[0]
    ratio = effects.get("gain_error", (1.0,))[0]
    negative = effects.get("asymmetric_gain", (1.0,))[0]
    leakage = effects.get("internal_leakage", (0.0,))[0]
    breakaway, release = effects.get("stiction", (0.0, 0.0))
    warmer, warm_up = effects.get("temperature_drift", (0.0, 1.0))
    loss = effects.get("load_dependent_flow", (0.0,))[0]
    frequency, damping = effects.get("oil_compressibility", (0.0, 0.0))
    omega = 2.0 * math.pi * frequency
    oil: tuple[float, float] | None = None
    spool = ramp = slow = float(command[0])
    moving = False
    x = begin
    out = np.empty(len(command))
    for k in range(len(command)):
        out[k] = x
        for part in range(PARTS):
            t = k * dt + (part + 0.5) * h - delay
            u = float(command[min(max(math.floor(t / dt), 0), len(command) - 1)])
            if abs(slow) < sticking_spool[1] and abs(u) < sticking_spool[0] + min(dead):
                u = 0.0
            if u - spool > play / 2:
                spool = u - play / 2
            elif spool - u > play / 2:
                spool = u + play / 2
            u = spool
            u = max(u - dead[0], 0.0) + min(u + dead[1], 0.0)
            u = (1.0 if u > 0 else -1.0 if u < 0 else 0.0) * abs(u) ** exponent
            u = limit if u > limit else -limit if u < -limit else u
            room = rate * h
            ramp = u if abs(u - ramp) <= room else ramp + (room if u > ramp else -room)
            slow = ramp + (slow - ramp) * math.exp(-h / lag) if lag > 0 else ramp
            v = slow * ratio * (negative if slow < 0 else 1.0)
            v *= 1.0 + warmer * (1.0 - math.exp(-(k * dt + (part + 0.5) * h) / warm_up))
            if load is not None and v != 0.0:
                v *= max(1.0 - loss * float(load[k]) * math.copysign(1.0, v), 0.0)
            v = gain * v - leakage
            moving = abs(v) / gain >= release if moving else abs(v) / gain > breakaway
            v = v if moving else 0.0
            if omega > 0.0:
                speed, slope = oil if oil is not None else (v, 0.0)
                oil = _spring(speed - v, slope, omega, damping, h)
                oil = (oil[0] + v, oil[1])
                v = 0.5 * (speed + oil[0])
            x += h * v
    return out


def _spring(x: float, v: float, omega: float, damping: float, h: float) -> tuple[float, float]:
    """``ẍ + 2ζω·ẋ + ω²·x = 0`` over a short step by the classical Runge-Kutta method."""

    def rates(x: float, v: float) -> tuple[float, float]:
        return v, -2.0 * damping * omega * v - omega * omega * x

    a = rates(x, v)
    b = rates(x + 0.5 * h * a[0], v + 0.5 * h * a[1])
    c = rates(x + 0.5 * h * b[0], v + 0.5 * h * b[1])
    d = rates(x + h * c[0], v + h * c[1])
    return x + h / 6.0 * (a[0] + 2.0 * b[0] + 2.0 * c[0] + d[0]), v + h / 6.0 * (a[1] + 2.0 * b[1] + 2.0 * c[1] + d[1])


def fed_by_one_pump(commands: Array, dt: float, gains: Sequence[float], limit: float) -> Array:
    """Travel (n, axes) of plain axes that share a pump: where they ask for too much all get the same part."""
    place, travel = [0.0] * len(gains), []
    for row in commands:
        travel.append(list(place))
        asked = [gain * float(u) for gain, u in zip(gains, row, strict=True)]
        demand = sum(abs(speed) / gain for speed, gain in zip(asked, gains, strict=True))
        part = limit / demand if demand > limit else 1.0
        place = [x + dt * part * speed for x, speed in zip(place, asked, strict=True)]
    return np.array(travel)


def servo_axis(
    command: Array,
    dt: float,
    delay: float = 0.0,
    rate: float = math.inf,
    lag: float = 0.0,
    second_order: tuple[float, float] | None = None,
) -> Array:
    """Position of a servo axis at the samples: the set-point, linear between samples, is held over the step that ends there."""
    h = dt / PARTS
    times = np.arange(len(command)) * dt
    ramp = slow = place = float(command[0])
    speed = 0.0
    out = np.empty(len(command))
    for k, u in enumerate(np.interp(times - delay, times, command)):
        for _ in range(PARTS):
            room = rate * h
            ramp = u if abs(u - ramp) <= room else ramp + (room if u > ramp else -room)
            slow = ramp + (slow - ramp) * math.exp(-h / lag) if lag > 0 else ramp
            if second_order is not None:
                away, speed = _spring(place - slow, speed, 1.0 / second_order[0], second_order[1], h)
                place = slow + away
        out[k] = slow if second_order is None else place
    return out


def force_axis(
    force: Array,
    dt: float,
    mass: float,
    coulomb: tuple[float, float] = (0.0, 0.0),
    viscous: tuple[float, float] = (0.0, 0.0),
    load: float = 0.0,
    stribeck: tuple[float, float, float] = (0.0, 0.0, 1.0),
    slope: float = 1e-5,
    constant: float = 1.0,
) -> Array:
    """Position of a mass from rest, (n,), by a stiff solver; dry friction regularised over ``slope`` [m/s]."""
    static, dynamic, film = stribeck

    def rates(t: float, state: Array, u: float) -> list[float]:
        v = state[1]
        side = 0 if v > 0 else 1
        dry = coulomb[side] + dynamic + (static - dynamic) * math.exp(-((v / film) ** 2))
        friction = dry * math.tanh(v / slope) + viscous[side] * v
        return [v, (constant * u - friction - load) / mass]

    state = np.zeros(2)
    out = np.empty(len(force))
    for k, u in enumerate(force):
        out[k] = state[0]
        done = solve_ivp(rates, (0.0, dt), state, method="Radau", args=(float(u),), rtol=1e-7, atol=1e-10)
        state = done.y[:, -1]
    return out


def two_masses(
    force: Array, dt: float, mass: float, frequency: float, damping_ratio: float, inertia_ratio: float, viscous: float = 0.0
) -> Array:
    """Position of a motor from rest, (n,), that moves a load through a spring and a damper, by a stiff solver.

    Args:
        mass: of both together; ``frequency``, ``damping_ratio``: of the load while the motor is held.
        viscous: friction of the motor.
    """
    motor = mass / (1.0 + inertia_ratio)
    load = mass - motor
    spring, damper = load * (2.0 * math.pi * frequency) ** 2, 2.0 * damping_ratio * load * 2.0 * math.pi * frequency

    def rates(t: float, state: Array, u: float) -> list[float]:
        x, v, y, w = state
        twist = spring * (x - y) + damper * (v - w)
        return [v, (u - viscous * v - twist) / motor, w, twist / load]

    state = np.zeros(4)
    out = np.empty(len(force))
    for k, u in enumerate(force):
        out[k] = state[0]
        done = solve_ivp(rates, (0.0, dt), state, method="DOP853", args=(float(u),), rtol=1e-9, atol=1e-12)
        state = done.y[:, -1]
    return out


def play(position: Array, width: float, begin: float) -> Array:
    """A follower pushed by two walls that are ``width`` apart."""
    follower = begin
    out = []
    for wall in position:
        lower, upper = wall - width / 2, wall + width / 2
        if follower < lower:
            follower = lower
        if follower > upper:
            follower = upper
        out.append(follower)
    return np.array(out)


def late(truth: Callable[[Array], Array], time: Array, skew: float, offset: float) -> Array:
    """What a stream writes at its own ``time`` (n,): the ``truth`` at the machine's time."""
    return truth(time * (1.0 + skew * 1e-6) + offset)


def pendulum(pivot: Array, dt: float, length: float, damping_ratio: float, longest_step: float = 0.2) -> Array:
    """Bob (n, 3) of a spherical pendulum below a moving pivot (n, 3), hanging at rest at the start.

    Newton's law in Cartesian coordinates with the tension that keeps ``|r| = length`` (r from pivot to bob):
    ``r̈ = g − a − c·ṙ − λ·r`` with ``λ = (r·(g − a − c·ṙ) + |ṙ|²)/L²``, ``c = 2ζ·√(g/L)`` (friction of the joints it hangs on).
    """
    time = np.arange(len(pivot)) * dt
    spline = CubicSpline(time, pivot, axis=0)
    acceleration: Callable[[float], Array] = spline.derivative(2)
    gravity = np.array([0.0, 0.0, -GRAVITY])
    drag = 2.0 * damping_ratio * math.sqrt(GRAVITY / length)

    def rates(t: float, state: Array) -> Array:
        r, v = state[:3], state[3:]
        free = gravity - acceleration(t) - drag * v
        tension = (r @ free + v @ v) / length**2
        return np.concatenate([v, free - tension * r])

    start = np.array([0.0, 0.0, -length, 0.0, 0.0, 0.0])
    done = solve_ivp(rates, (0.0, time[-1]), start, t_eval=time, method="DOP853", rtol=1e-9, atol=1e-11, max_step=longest_step)
    return np.asarray(pivot + done.y[:3].T)
