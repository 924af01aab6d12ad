"""Machines and logs at the edges of what numbers can be: rates, counts, sizes, constant and missing values, units.

Each value is one of a list. What chooses makes the case: the bytes of a fuzzer, or a strategy of Hypothesis.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import pandas as pd

T = TypeVar("T")
Choose = Callable[[Sequence[Any]], Any]
Array = npt.NDArray[np.float64]

RATES = (100.0, 1.0, 2.0, 7.3, 50.0, 1000.0, 10_000.0)
SAMPLES = (600, 0, 1, 2, 3, 5, 20, 60, 2000)
AXES = (1, 2, 3, 6, 40)
RECORDINGS = (3, 1, 2, 5)
DRIVES = (("velocity", "joint"), ("velocity", "cylinder"), ("position", "joint"), ("force", "joint"), ("position", "cylinder"))
COMMANDS = ("steps", "constant", "zero", "sine", "noise", "gap", "missing", "late")
MOTIONS = ("follows", "still", "ramp", "noise", "gap", "missing", "one", "jump", "counts", "overflow")
SIZES = (1.0, 1e-12, 1e-6, 1e-3, 1e3, 1e6, 1e12, 1e300, -1.0, 0.0)
UNITS = (None, "rad", "deg", "m", "mm", "um", "rev")
STAMPS = ("even", "epoch", "jitter", "twice", "back", "still", "huge", "gap")
LIMITS = ((-10.0, 10.0), (-1e9, 1e9), (0.0, 1e-9), (1e6, 1e6 + 1.0), None)
GAINS = (0.5, 1e-12, 1e-6, 1e6, 1e9)
#: Of the values of all logs of a case: forty axes with a thousand samples would take seconds.
MOST_VALUES = 20_000


@dataclass(frozen=True)
class EdgeAxis:
    """One axis; ``size`` scales its measured motion, ``unit`` is that of its column."""

    drive: tuple[str, str]
    command: str
    motion: str
    size: float
    unit: str | None
    limits: tuple[float, float] | None
    gain: float
    prismatic: bool


@dataclass(frozen=True)
class EdgeMachine:
    """A machine and its recordings; ``samples`` and ``stamps`` are of the recordings in turn."""

    rate_hz: float
    log_rate: float
    axes: tuple[EdgeAxis, ...]
    samples: tuple[int, ...]
    stamps: tuple[str, ...]
    bodies: bool
    seed: int = 0
    effects: tuple[dict[str, Any], ...] = field(default=())


def edge_machine(choose: Choose) -> EdgeMachine:
    """A case; ``choose`` takes one of a sequence. The first of each sequence is an ordinary machine."""
    count = choose(AXES)
    rate = choose(RATES)
    recordings = choose(RECORDINGS)
    alike = choose((True, False))
    axes: list[EdgeAxis] = []
    for number in range(count):
        axes.append(axes[0] if alike and number else _axis(choose))
    longest = MOST_VALUES // (2 * count * recordings)
    samples = tuple(min(choose(SAMPLES), longest) for _ in range(recordings))
    stamps = tuple(choose(STAMPS) for _ in range(recordings))
    return EdgeMachine(
        rate, rate * choose((1.0, 1.0, 0.1, 3.0, 1e-3)), tuple(axes), samples, stamps, choose((False, True)), choose(range(8))
    )


def _axis(choose: Choose) -> EdgeAxis:
    drive, command, motion, size = choose(DRIVES), choose(COMMANDS), choose(MOTIONS), choose(SIZES)
    return EdgeAxis(drive, command, motion, size, choose(UNITS), choose(LIMITS), choose(GAINS), choose((False, True)))


def from_bytes(data: bytes) -> EdgeMachine:
    """A byte a choice; the first of each sequence where they end."""
    rest = iter(data)
    return edge_machine(lambda options: options[next(rest, 0) % len(options)])


def write_machine(case: EdgeMachine, folder: Path) -> Path:
    """``machine.toml``, its URDF, ``recipe.toml`` and the logs; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    head: dict[str, Any] = {"schema": 1, "name": "edge", "rate_hz": case.rate_hz}
    if case.bodies:
        head |= {"urdf": "edge.urdf", "tip": f"l{len(case.axes)}"}
        (folder / "edge.urdf").write_text(_urdf(case))
    tables = [head, *(_described(axis, number, case.bodies) for number, axis in enumerate(case.axes))]
    texts = ("\n".join(f"{key} = {json.dumps(value)}" for key, value in table.items()) for table in tables)
    (folder / "machine.toml").write_text("\n[[axes]]\n".join(texts) + "\n")
    lines = ["schema = 1", 'machine = "machine.toml"', 'logs = "logs"', "[[streams]]", 'files = "*.csv"', 'time = "time"']
    lines += ["[streams.signals]", *_columns(case)]
    (folder / "recipe.toml").write_text("\n".join(lines) + "\n")
    for number, (samples, stamps) in enumerate(zip(case.samples, case.stamps, strict=True)):
        place = folder / "logs" / f"r{number}"
        place.mkdir(parents=True)
        table(case, number, samples, stamps).to_csv(place / "log.csv", index=False)
    return folder


def table(case: EdgeMachine, number: int, samples: int, stamps: str) -> pd.DataFrame:
    """The log of one recording, its values in the units of its columns."""
    rng = np.random.default_rng([case.seed, number])
    columns = {"time": _stamps(stamps, samples, case.log_rate, rng)}
    for k, axis in enumerate(case.axes):
        command = _commands(axis.command, samples, rng)
        columns[f"a{k}.command"] = command
        columns[_measured(axis, k)] = _motion(axis, command, case.log_rate, rng)
    return pd.DataFrame(columns)


def _measured(axis: EdgeAxis, k: int) -> str:
    return f"a{k}.{axis.drive[1]}"


def _columns(case: EdgeMachine) -> list[str]:
    lines = []
    for k, axis in enumerate(case.axes):
        lines.append(f'"a{k}.command" = {{ field = "a{k}.command" }}')
        name, unit = _measured(axis, k), "" if axis.unit is None else f', unit = "{axis.unit}"'
        lines.append(f'"{name}" = {{ field = "{name}"{unit} }}')
    return lines


def _described(axis: EdgeAxis, k: int, bodies: bool) -> dict[str, Any]:
    actuation, drives = axis.drive
    found: dict[str, Any] = {"name": f"a{k}", "actuation": actuation, "drives": drives}
    if bodies:
        found["joint"] = f"j{k}"
    else:
        found["joint_type"] = "prismatic" if axis.prismatic else "revolute"
    if actuation == "velocity":
        found["gain"] = axis.gain
    if actuation == "force":
        found["inertia"] = axis.gain
    if drives == "cylinder":
        found["stroke"] = list(axis.limits or (0.0, 1.0))
    elif axis.limits is not None:
        found["limits"] = list(axis.limits)
    return found


def _urdf(case: EdgeMachine) -> str:
    parts = ['<link name="l0"/>']
    for k, axis in enumerate(case.axes):
        kind = "prismatic" if axis.prismatic else "revolute"
        parts.append(
            f'<joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{k + 1}"/><origin xyz="0.1 0 0"/>'
            f'<axis xyz="0 {k % 2} {1 - k % 2}"/><limit lower="-3" upper="3"/></joint><link name="l{k + 1}"/>'
        )
    return f'<robot name="edge">{"".join(parts)}</robot>'


def _stamps(kind: str, n: int, rate: float, rng: np.random.Generator) -> Array:
    time = np.arange(n) / rate
    if kind == "epoch":
        return time + 1.7e9
    if kind == "jitter":
        return time + rng.uniform(-0.4, 0.4, n) / rate
    if kind == "twice":
        return np.repeat(time, 2)[:n]
    if kind == "back":
        return np.where(np.arange(n) < n // 2, time, time - 0.3 * n / rate)
    if kind == "still":
        return np.zeros(n)
    if kind == "huge":
        return time * 1e9
    return np.where(np.arange(n) < n // 2, time, time + 100.0 * n / rate) if kind == "gap" else time


def _commands(kind: str, n: int, rng: np.random.Generator) -> Array:
    at = np.arange(n)
    if kind in ("constant", "zero", "missing"):
        return np.full(n, {"constant": 0.3, "zero": 0.0, "missing": np.nan}[kind])
    if kind == "sine":
        return 0.7 * np.sin(at / 15.0)
    if kind == "noise":
        return rng.uniform(-1.0, 1.0, n)
    steps = np.repeat(rng.choice([-0.6, -0.3, 0.0, 0.4, 0.8], n // 25 + 1), 25)[:n]
    if kind == "gap":
        steps[n // 3 : n // 2] = np.nan
    if kind == "late":
        steps[: n // 2] = np.nan
    return steps


def _motion(axis: EdgeAxis, command: Array, rate: float, rng: np.random.Generator) -> Array:
    n = len(command)
    known = np.nan_to_num(command)
    path = known.copy() if axis.drive[0] == "position" else np.cumsum(0.5 * known) / rate
    path += 1e-4 * rng.standard_normal(n)
    if axis.motion == "still":
        path = np.full(n, 0.2)
    elif axis.motion == "ramp":
        path = np.arange(n) / rate
    elif axis.motion == "noise":
        path = rng.standard_normal(n)
    elif axis.motion == "gap":
        path[n // 4 : n // 2] = np.nan
    elif axis.motion == "missing":
        path = np.full(n, np.nan)
    elif axis.motion == "one":
        path = np.where(np.arange(n) == n // 2, path, np.nan)
    elif axis.motion == "overflow":
        path[n // 3 : n // 2] = rng.choice([np.inf, -np.inf, 9.9e37, -3.4e38, 1e308], n // 2 - n // 3)
    elif axis.motion == "jump":
        path = path + 5.0 * (np.arange(n) >= n // 2)
    elif axis.motion == "counts":
        path = np.round(path * 100.0) / 100.0
    with np.errstate(over="ignore"):
        return np.asarray(axis.size * path, dtype=np.float64)
