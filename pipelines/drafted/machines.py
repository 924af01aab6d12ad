"""Machines with random axes, columns, units, rates and motions, and logs of them as people keep them.

The equations are those of this file: a valve moves a cylinder or a joint with a dead time, a lag, a dead-band and another
speed backwards; a servo follows its setpoint with a dead time and a lag; a force or torque moves a mass with friction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.signal import lfilter

Array = npt.NDArray[np.float64]

#: Step of the simulation [s]; length of a recording [s], and of its rows.
STEP_S, SECONDS, ROWS = 0.002, (30.0, 60.0), 25_000
#: SI value of a unit of motion.
FACTORS = {
    "mm": 1e-3, "cm": 1e-2, "m": 1.0, "deg": math.pi / 180.0, "rad": 1.0, "turn": 2.0 * math.pi,
    "4096/turn": 2.0 * math.pi / 4096.0,
}  # fmt: skip
LENGTHS = ("mm", "cm", "m")
RATES = (20.0, 25.0, 30.0, 50.0, 60.0, 100.0, 125.0, 150.0, 200.0, 240.0, 250.0, 400.0, 500.0, 1000.0)

#: Names of axes, as a machine's owner writes them: those that a cylinder or a slide moves, and joints.
CYLINDERS = ("boom", "stick", "bucket", "arm", "lift", "tilt", "jib", "Ausleger", "Stiel", "Löffel", "Hub", "mast", "telescope")
JOINTS = (
    "slew",
    "swing",
    "shoulder",
    "elbow",
    "wrist",
    "base",
    "Drehwerk",
    "Schulter",
    "Greifer",
    "grip",
    "knee",
    "hip",
    "pan",
)

Name = Callable[[str, int], str]


@dataclass(frozen=True)
class Style:
    """Names of the columns of an axis, from its name and its number: command, motion, and beside them joystick and speed.

    Args:
        only: lengths or angles, where the names say which.
    """

    command: Name
    motion: Name
    operator: Name | None = None
    speed: Name | None = None
    only: str = ""


def _style(command: str, motion: str, operator: str | None = None, speed: str | None = None, only: str = "") -> Style:
    def name(pattern: str) -> Name:
        return lambda axis, k: pattern.format(n=axis, T=axis.title(), k=k, one=k + 1)

    return Style(name(command), name(motion), name(operator) if operator else None, name(speed) if speed else None, only)


#: Of any command.
COMMON = (
    _style("{T} Cmd", "{T} Ms", "{T} JS"),
    _style("cmd_{n}", "pos_{n}", None, "vel_{n}"),
    _style("u{one}", "y{one}"),
    _style("u_{n}", "y_{n}"),
    _style("{n}_cmd", "{n}_meas", "joy_{n}", "{n}_speed"),
    _style("{n}Command", "{n}Position"),
    _style("command[{k}]", "position[{k}]", None, "velocity[{k}]"),
    _style("Soll_{n}", "Ist_{n}"),
    _style("{n}.cmd", "{n}.pos", None, "{n}.vel"),
    _style("{n}/command", "{n}/feedback"),
    _style("{T} Stellwert", "{T} Istwert"),
    _style("{n} in", "{n} out"),
    _style("ref_{one}", "act_{one}"),
    _style("input_{n}", "output_{n}"),
)
#: Of a valve, a servo, a force.
OWN = {
    "valve": (
        _style("pwm_{n}", "enc_{n}"),
        _style("valve_{n}", "len_{n}", only="lengths"),
        _style("Ventil {T}", "Weg {T}", "Joystick {T}", only="lengths"),
        _style("PWM{one}", "sensor{one}"),
        _style("{n}_duty", "{n}_cyl", only="lengths"),
        _style("Stellgröße {T}", "Zylinder {T}", only="lengths"),
        _style("i_valve_{n}", "wire_{n}", only="lengths"),
        _style("DAC {one}", "Pos {one}"),
        _style("{n}_spool_cmd", "{n}_stroke", only="lengths"),
    ),
    "servo": (
        _style("target pos ({one})", "pos ({one})", None, "speed ({one})"),
        _style("goal_pos_{one}", "present_pos_{one}"),
        _style("goal_position_{n}", "present_position_{n}"),
        _style("q_des[{k}]", "q[{k}]", None, "qd[{k}]"),
        _style("joint_{one}.target", "joint_{one}.position", None, "joint_{one}.velocity"),
        _style("{n}Setpoint", "{n}Actual"),
        _style("Sollwinkel {T}", "Istwinkel {T}", only="angles"),
        _style("{n}_ref", "{n}_fb"),
        _style("qd_{one}", "q_{one}"),
        _style("{n} setpoint", "{n} angle", only="angles"),
        _style("desired_{n}", "measured_{n}"),
    ),
    "force": (
        _style("tau_{one}", "q_{one}", None, "qd_{one}"),
        _style("{n}_torque", "{n}_pos", None, "{n}_vel", only="angles"),
        _style("effort[{k}]", "position[{k}]", None, "velocity[{k}]"),
        _style("Moment {T}", "Winkel {T}", only="angles"),
        _style("torque_cmd_{one}", "pos{one}", None, "vel{one}", only="angles"),
        _style("{n}_force", "{n}_position", only="lengths"),
        _style("tau{one}", "pos{one}"),
    ),
}
#: Columns that are no axis.
OTHERS = ("battery_voltage", "oil_temp", "mode", "loop_counter", "cpu_load", "Druck Pumpe")


@dataclass(frozen=True)
class Axis:
    """An axis, and what a right description of it has.

    Args:
        kind: valve, servo or force; ``drives``: cylinder or joint.
        command, motion: names of its columns, without a unit.
        zero, span: raw command at rest, and from there to full; ``turns``: -1 where a larger raw command moves it backwards.
        gain: speed at full command [SI]; ``dead``: share of the command without motion; ``back``: speed backwards as a share.
        unit, command_unit: of motion and, of a servo or a force, of the command.
        inertia: of a force axis [SI].
    """

    name: str
    kind: str
    drives: str
    command: str
    motion: str
    zero: float
    span: float
    turns: int
    gain: float
    dead: float
    back: float
    unit: str
    command_unit: str
    inertia: float

    def speed_at(self, raw: float) -> float:
        """Steady speed [SI] at a raw command."""
        share = np.array([self.turns * (raw - self.zero) / self.span])
        return float(self._flow(share)[0])

    def _flow(self, share: Array) -> Array:
        live = np.sign(share) * np.maximum(np.abs(share) - self.dead, 0.0)
        found: Array = self.gain * np.clip(np.where(live < 0.0, self.back * live, live), -1.0, 1.0)
        return found

    def moved(self, share: Array, start: float, ends: tuple[float, float], delay: float, lag: float) -> Array:
        """Place [SI] of a valve axis after the commands ``share`` (n,), −1 to 1, every :data:`STEP_S`."""
        flow = _lagged(_late(self._flow(share), delay), lag)
        place, found = start, np.empty(len(flow))
        for k, speed in enumerate(flow):
            place = min(max(place + speed * STEP_S, ends[0]), ends[1])
            found[k] = place
        return found


@dataclass(frozen=True)
class Machine:
    """What is generated: axes, rate of the fastest log [Hz], unit of the time, and by axis the range in the logs [SI]."""

    kind: str
    form: str
    axes: tuple[Axis, ...]
    rate_hz: float
    time_unit: str
    states_units: bool
    ends: dict[str, tuple[float, float]]


def _late(values: Array, delay: float) -> Array:
    steps = round(delay / STEP_S)
    return np.concatenate([np.full(steps, values[0]), values[: len(values) - steps]]) if steps else values


def _lagged(values: Array, lag: float) -> Array:
    share = STEP_S / (lag + STEP_S)
    found: Array = lfilter([share], [1.0, share - 1.0], values, zi=[values[0] * (1.0 - share)])[0]
    return found


def generate(folder: Path, seed: int) -> Machine:
    """Logs of a machine in ``folder``, and what is true of it."""
    rng = np.random.default_rng([seed, 2026])
    kind = str(rng.choice(["valve", "servo", "force"], p=[0.5, 0.35, 0.15]))
    style = [*COMMON, *OWN[kind]][rng.integers(len(COMMON) + len(OWN[kind]))]
    if kind == "force" and style in COMMON:  # names say that it is a force, or a person says so
        style = OWN[kind][rng.integers(len(OWN[kind]))] if rng.random() < 0.7 else style
    stated = str(rng.choice(["none", "[]", "()", "_"], p=[0.4, 0.3, 0.2, 0.1]))
    axes = _axes(rng, kind, style, stated)
    rate = float(rng.choice(RATES))
    recordings = int(rng.integers(1, 6))
    seconds = min(float(rng.uniform(*SECONDS)), ROWS / rate)
    form = str(rng.choice(["csv", "semicolons", "tabs", "parquet", "two files"], p=[0.45, 0.2, 0.1, 0.1, 0.15]))
    clock = _clock(rng, form)
    noise = [10.0 ** rng.uniform(-4.5, -3.0) for _ in axes]
    steps = [float(rng.choice([0.0, 1.0])) * 10.0 ** rng.uniform(-4.0, -2.7) for _ in axes]
    how = str(rng.choice(["manual", "steps", "sines"], p=[0.5, 0.3, 0.2]))
    drive = [_Drive.of(rng, axis, how) for axis in axes]
    jitter, missing = float(rng.choice([0.0, 0.02, 0.15])), float(rng.choice([0.0, 0.0, 0.002]))
    others = [str(name) for name in rng.permutation(OTHERS)[: rng.integers(0, 4)]]
    beside = bool(rng.random() < 0.4)
    names = _recording_names(rng, recordings)
    ends: dict[str, tuple[float, float]] = {}
    folder.mkdir(parents=True)
    for number, name in enumerate(names):
        time = _stamps(rng, seconds, rate, jitter)
        commands, motions, extra = {}, {}, {}
        for axis, own, sigma, step in zip(axes, drive, noise, steps, strict=True):
            raw, place = own.recorded(rng, seconds)
            grid = np.arange(len(place)) * STEP_S
            truth = np.interp(time, grid, place)
            given = raw[np.clip(np.searchsorted(grid, time, "right") - 1, 0, len(raw) - 1)]
            factor, size = FACTORS[axis.unit], own.size
            seen = (truth + size * sigma * rng.normal(size=len(time))) / factor
            resolution = 1.0 if axis.unit == "4096/turn" else step * size / factor
            seen = np.round(seen / resolution) * resolution if resolution > 0.0 else seen
            seen[rng.random(len(seen)) < missing] = np.nan
            low, high = ends.get(axis.name, (math.inf, -math.inf))
            reached = np.concatenate([truth, given * FACTORS[axis.command_unit]]) if axis.kind == "servo" else truth
            ends[axis.name] = min(low, float(reached.min())), max(high, float(reached.max()))
            commands[_header(axis.command, _command_unit(axis, stated), stated)] = given
            motions[_header(axis.motion, axis.unit, stated)] = seen
            k = axes.index(axis)
            if beside and style.operator is not None:
                extra[style.operator(axis.name, k)] = np.round(100.0 * (given - axis.zero) / axis.span)
            if beside and style.speed is not None:
                rated = np.gradient(truth, time) / factor
                extra[style.speed(axis.name, k)] = rated + 0.01 * np.abs(rated).max() * rng.normal(size=len(time))
        for other in others:
            extra[other] = np.cumsum(rng.normal(size=len(time))) * 1e-3 + 20.0 if other != "mode" else (time > 5.0) * 1.0
        _write(folder, name, form, clock.column(time, 100.0 * number), commands, motions, extra)
    return Machine(kind, form, tuple(axes), rate, clock.unit, stated != "none", ends)


def _axes(rng: np.random.Generator, kind: str, style: Style, stated: str) -> list[Axis]:
    """One to six axes of one machine; an excavator has cylinders and a slewing joint."""
    count = int(rng.choice([1, 2, 3, 4, 6], p=[0.25, 0.25, 0.25, 0.15, 0.1]))
    length, angle = str(rng.choice(["mm", "m", "cm"], p=[0.5, 0.35, 0.15])), str(rng.choice(["deg", "rad"]))
    if kind == "servo" and rng.random() < 0.2:
        angle = "4096/turn" if stated == "none" else "turn"
    straight = [bool(rng.random() < (0.75 if kind == "valve" else 0.15)) for _ in range(count)]
    if style.only or (stated == "none" and kind != "valve"):
        straight = [style.only == "lengths" if style.only else straight[0]] * count
    names = [str(rng.choice(CYLINDERS if own else JOINTS)) for own in straight]
    while len({*names}) < count:
        names = [str(rng.choice(CYLINDERS if own else JOINTS)) for own in straight]
    scale = rng.integers(6) if kind == "valve" else 0
    found = []
    for k, name in enumerate(names):
        zero, span = _scale(rng, int(scale))
        unit = length if straight[k] else angle
        drives = "cylinder" if kind == "valve" and straight[k] else "joint"
        gain = float(rng.uniform(0.02, 0.3) if straight[k] else rng.uniform(0.2, 1.5))
        dead, back = float(rng.choice([0.0, rng.uniform(0.02, 0.25)])), float(rng.choice([1.0, rng.uniform(0.6, 1.3)]))
        command_unit = unit if kind == "servo" else ("N" if straight[k] else "N·m") if kind == "force" else ""
        inertia = float(rng.uniform(1.0, 100.0) if straight[k] else rng.uniform(0.02, 5.0))
        turns = -1 if kind == "valve" and rng.random() < 0.2 else 1
        found.append(Axis(
            name, kind, drives, style.command(name, k), style.motion(name, k), zero, span, turns, gain, dead, back, unit,
            command_unit, inertia,
        ))  # fmt: skip
    return found


def _scale(rng: np.random.Generator, scale: int) -> tuple[float, float]:
    """Raw command of a valve at rest, and from there to full: a share, per cent, µs, 8 bits, V, duty cycle in per cent."""
    return (
        (0.0, 1.0), (0.0, 100.0), (1500.0 + float(rng.integers(-20, 21)), 400.0), (127.0, 127.0), (2.5, 2.5),
        (7.5 + round(float(rng.uniform(-0.6, 0.6)), 3), 2.5),
    )[scale]  # fmt: skip


def _command_unit(axis: Axis, stated: str) -> str | None:
    if axis.kind != "valve":
        return axis.command_unit
    return {1.0: None, 100.0: "%", 400.0: "us", 2.5: "V" if axis.zero == 2.5 else "%"}.get(axis.span)


def _header(name: str, unit: str | None, stated: str) -> str:
    if stated == "none" or unit in (None, "", "4096/turn"):
        return name
    if stated == "_":
        return f"{name}_{unit.replace('·', '').replace('%', 'pct')}" if unit is not None else name
    return f"{name} [{unit}]" if stated == "[]" else f"{name} ({unit})"


@dataclass(frozen=True)
class _Drive:
    """How an axis is driven in all recordings. ``size``: range of its motion [SI]; ``most``: largest share of the command."""

    axis: Axis
    how: str
    middle: float
    size: float
    most: float
    delay: float
    lag: float
    update_s: float

    @classmethod
    def of(cls, rng: np.random.Generator, axis: Axis, how: str) -> _Drive:
        straight = axis.unit in LENGTHS
        size = (
            float(rng.uniform(3.0, 8.0)) * axis.gain
            if axis.kind == "valve"
            else float(rng.uniform(0.2, 1.0) if straight else rng.uniform(0.5, 3.0))
        )
        if axis.drives == "cylinder":
            middle = 0.5 * size + float(rng.choice([0.0, rng.uniform(0.05, 0.5)]))
        else:
            middle = float(rng.choice([0.0, rng.uniform(-0.5, 0.5)]))
        middle = math.pi if axis.unit == "4096/turn" else middle
        most = float(rng.choice([1.0, 1.0, rng.uniform(0.6, 1.0)]))
        update = float(rng.choice([0.02, 0.05]))
        return cls(axis, how, middle, size, most, float(rng.uniform(0.02, 0.25)), float(rng.uniform(0.03, 0.2)), update)

    def recorded(self, rng: np.random.Generator, seconds: float) -> tuple[Array, Array]:
        """Raw command and place [SI] every :data:`STEP_S`, (n,) each."""
        axis, count = self.axis, int(seconds / STEP_S) + 2
        if axis.kind == "valve":
            share = self._held(self._share(rng, count))
            raw = axis.zero + axis.turns * axis.span * share
            places = {1.0: 3, 100.0: 0, 400.0: 0, 127.0: 0}.get(axis.span, 3)
            raw = np.round(raw, places)
            share = axis.turns * (raw - axis.zero) / axis.span
            ends = self.middle - 0.5 * self.size, self.middle + 0.5 * self.size
            return raw, axis.moved(share, float(rng.uniform(*ends)), ends, self.delay, self.lag)
        setpoint = self._held(self.middle + 0.5 * self.size * self._wanted(rng, count))
        if axis.kind == "servo":
            factor = FACTORS[axis.command_unit]
            raw = np.round(setpoint / factor) if axis.command_unit == "4096/turn" else np.round(setpoint / factor, 4)
            place = _lagged(_lagged(_late(raw * factor, self.delay), 0.5 * self.lag), 0.5 * self.lag)
            return raw, place - 0.002 * self.size * np.sin(place)
        return self._forced(setpoint)

    def _forced(self, setpoint: Array) -> tuple[Array, Array]:
        """A position controller moves a mass: force [N, N·m] and place."""
        mass, stiff = self.axis.inertia, 100.0
        viscous, coulomb, load = 0.5 * mass, 0.3 * mass * self.size, 0.1 * mass
        place, speed, force = float(setpoint[0]), 0.0, 0.0
        forces, places = np.empty(len(setpoint)), np.empty(len(setpoint))
        every = max(round(self.update_s / STEP_S) // 4, 1)
        smooth = _lagged(_lagged(setpoint, self.lag), self.lag)
        for k, wanted in enumerate(smooth):
            if k % every == 0:
                force = mass * (stiff * (wanted - place) - 14.0 * speed)
            forces[k], places[k] = force, place
            friction = viscous * speed + coulomb * math.tanh(speed / (0.005 * self.size))
            speed += STEP_S * (force - friction - load) / mass
            place += STEP_S * speed
        return forces, places

    def _held(self, values: Array) -> Array:
        """A controller writes its command every :attr:`update_s`."""
        rows = max(round(self.update_s / STEP_S), 1)
        return np.repeat(values[::rows], rows)[: len(values)]

    def _share(self, rng: np.random.Generator, count: int) -> Array:
        """Commands of a valve, −1 to 1: a stick that is pushed and released, steps, or sines."""
        time = np.arange(count) * STEP_S
        if self.how == "sines":
            slow = 1.0 / max(2.0 * self.size / self.axis.gain, 4.0)
            waves = sum(
                a * np.sin(2.0 * np.pi * f * time + p)
                for a, f, p in zip((0.6, 0.4), (slow, slow * rng.uniform(1.5, 3.0)), rng.uniform(0, 6, 2), strict=True)
            )
            return np.asarray(self.most * waves)
        found, k, place = np.zeros(count), round(float(rng.uniform(0.5, 2.0)) / STEP_S), 0.0
        while k < count:
            push = round(float(rng.uniform(0.8, 3.0)) / STEP_S)
            level = 1.0 if self.how == "steps" and rng.random() < 0.5 else float(rng.choice([1.0, rng.uniform(0.3, 1.0)]))
            side = -np.sign(place) if abs(place) > 0.25 else float(rng.choice([-1.0, 1.0]))
            ramp = 1.0 if self.how == "steps" else 0.3
            rise = np.minimum(np.arange(push) * STEP_S / max(ramp if self.how != "steps" else STEP_S, STEP_S), 1.0)
            part = side * self.most * level * np.minimum(rise, rise[::-1])
            found[k : k + push] = part[: len(found[k : k + push])]
            place += float(part.sum()) * STEP_S * self.axis.gain / self.size
            k += push + round(float(rng.uniform(0.4, 2.0)) / STEP_S)
        return found

    def _wanted(self, rng: np.random.Generator, count: int) -> Array:
        """Setpoints within −1 to 1: steps, sines, or points with smooth ways between them."""
        time = np.arange(count) * STEP_S
        if self.how == "sines":
            parts = zip((0.6, 0.4), rng.uniform([0.05, 0.2], [0.2, 0.5]), rng.uniform(0, 6, 2), strict=True)
            return np.asarray(sum(a * np.sin(2.0 * np.pi * f * time + p) for a, f, p in parts))
        stops = np.cumsum(rng.uniform(1.0, 3.0, int(time[-1]) + 2))
        levels = rng.uniform(-1.0, 1.0, len(stops))
        if self.how == "steps":
            return np.asarray(levels[np.searchsorted(stops, time)])
        whole = np.interp(time, stops, levels)
        rows = round(0.4 / STEP_S)
        return np.convolve(np.pad(whole, (rows // 2, rows - rows // 2 - 1), "edge"), np.ones(rows) / rows, "valid")


@dataclass(frozen=True)
class _Clock:
    """The column of the time. ``unit``: s, ms, us or ns; ``begin``: first stamp [s]; ``dated``: text or datetimes."""

    name: str
    unit: str
    begin: float
    dated: bool

    def column(self, time: Array, later: float) -> tuple[str, object]:
        seconds = time + later
        if self.dated:
            return self.name, pd.to_datetime(np.int64(1.7e18) + np.round(seconds * 1e6).astype(np.int64) * 1000)
        whole = {"s": None, "ms": 1e3, "us": 1e6, "ns": 1e9}[self.unit]
        if whole is None:
            return self.name, np.round(self.begin + seconds, 6)
        return self.name, round(self.begin * whole) + np.round(seconds * whole).astype(np.int64)


def _clock(rng: np.random.Generator, form: str) -> _Clock:
    unit = str(rng.choice(["s", "ms", "us", "ns"], p=[0.55, 0.25, 0.12, 0.08]))
    dated = bool(rng.random() < 0.12)
    if dated:
        return _Clock(str(rng.choice(["time", "timestamp"])), "s", 0.0, True)
    plain = {"s": ("time", "t", "Time", "timestamp"), "ms": ("time", "t", "timestamp"), "us": ("time",), "ns": ("timestamp",)}[
        unit
    ]
    named = {
        "s": ("time [s]", "Time (s)", "Zeit [s]", "t_s"),
        "ms": ("time_ms", "t [ms]", "Zeit (ms)"),
        "us": ("time_us", "t [us]"),
        "ns": ("t_ns",),
    }[unit]
    begin = float(rng.choice([0.0, round(float(rng.uniform(5.0, 5000.0)), 3), 1.7e9]))
    return _Clock(str(rng.choice(named if rng.random() < 0.5 else plain)), unit, begin, False)


def _stamps(rng: np.random.Generator, seconds: float, rate: float, jitter: float) -> Array:
    """Times of the rows [s]: even, but for jitter and now and then a pause."""
    time = np.arange(int(seconds * rate)) / rate
    time = time + np.clip(jitter * rng.normal(size=len(time)), -0.4, 0.4) / rate
    if rng.random() < 0.3:
        at = rng.uniform(5.0, seconds - 2.0)
        time = time[(time < at) | (time > at + 1.0)]
    return np.clip(np.round(time, 6), 0.0, None)


def _recording_names(rng: np.random.Generator, count: int) -> list[str]:
    """Names of recordings: their role or motion, a number, a date."""
    patterns = ("run{k}", "log_2024-03-0{k}", "manual_{k}", "test{k}", "Fahrt {k}")
    roles = ("train_1", "train_2", "train_3", "validation", "test")
    chosen = str(rng.choice([*patterns, "roles"]))
    return [*roles[-count:]] if chosen == "roles" else [chosen.format(k=k + 1) for k in range(count)]


def _write(
    folder: Path, name: str, form: str, time: tuple[str, object], commands: dict[str, Array], motions: dict[str, Array],
    extra: dict[str, Array],
) -> None:  # fmt: skip
    if form == "two files":
        (folder / name).mkdir()
        for stem, columns in (("control", commands), ("state", motions | extra)):
            pd.DataFrame(dict([time]) | columns).to_csv(folder / name / f"{stem}.csv", index=False, float_format="%.6f")
        return
    pairs = zip(commands.items(), motions.items(), strict=True)
    table = pd.DataFrame(dict([time]) | dict(column for pair in pairs for column in pair) | extra)
    if form == "parquet":
        table.to_parquet(folder / f"{name}.parquet")
        return
    mark, decimal = {"csv": (",", "."), "semicolons": (";", ","), "tabs": ("\t", ".")}[form]
    table.to_csv(folder / f"{name}.csv", index=False, float_format="%.6f", sep=mark, decimal=decimal)
