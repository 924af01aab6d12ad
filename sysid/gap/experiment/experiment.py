"""One recording to make: its commands, initial position, limits and expected information, and its two files.

``NAME.toml`` is the specification, ``NAME.csv`` the commands. The CSV has canonical column names, so that spreadsheets and
``sysid`` can read it; its sha256 is in the TOML file, so that the two are not mixed with files of another experiment.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from sysid.config import Strict, inside, load_settings
from sysid.errors import SettingsError, nearest
from sysid.files import written_whole
from sysid.machine import Machine
from sysid.names import check_file_name
from sysid.quoting import toml_key, toml_value
from sysid.signals import axis_signal

Limits = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class EffectAt(Strict):
    """An effect and its target."""

    name: str
    target: str


@dataclass(frozen=True)
class Purpose(Strict):
    """An open hypothesis that the recording resolves.

    Args:
        kind: ``tie`` (effects that are not identifiable), or ``excitation`` (an effect that is not excited so far).
        text: what is expected, in words.
        effects: those of the hypothesis.
        nats: expected log-likelihood ratio of the least separated pair, with the rejected model refitted.
        needed: nats from which the hypothesis counts as resolved.
    """

    kind: Literal["tie", "excitation"]
    text: str
    effects: tuple[EffectAt, ...]
    nats: float
    needed: float


@dataclass(frozen=True)
class _Specification(Strict):
    """What an experiment and its TOML file have in common."""

    name: str
    machine: str
    motion: str
    about: str
    axes: tuple[str, ...]
    rate_hz: float
    repeats: int
    start: Mapping[str, float]
    limits: Limits
    predicted: Limits
    purposes: tuple[Purpose, ...]
    provenance: Mapping[str, str | int]


@dataclass(frozen=True)
class Experiment(_Specification):
    """One recording to make.

    Args:
        machine: name in ``machine.toml``.
        motion, about: name in :data:`sysid.gap.experiment.motions.MOTIONS`, and its description.
        axes: axes that move; the others are held by their commands.
        repeats: number of recordings needed for ``needed`` nats.
        start: signal → initial value [m, rad].
        limits: signal → (lowest, highest) value of a command or a measurement during the recording. The machine has to be
            stopped where a measurement leaves its limits.
        predicted: signal → (lowest, highest) value in the simulations.
        provenance: dataset and plant versions, seed, software.
        commands: ``time`` [s] on the grid k/rate_hz and ``<axis>.command`` of every axis. For a force axis,
            ``<axis>.joint`` is the path for a position controller, and its command is the force expected for that path.
    """

    commands: pd.DataFrame = field(compare=False)

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return len(self.commands) / self.rate_hz

    @property
    def words(self) -> str:
        """One-line description."""
        again = f", {self.repeats} times" if self.repeats > 1 else ""
        return f"{self.about} ({self.seconds:.0f} s{again}): {' '.join(purpose.text for purpose in self.purposes)}"


def outside(table: pd.DataFrame, limits: Limits) -> list[str]:
    """Signals of ``table`` that leave their limits anywhere; NaN values are ignored."""
    left = []
    for signal, (low, high) in limits.items():
        if signal in table.columns:
            values = table[signal].to_numpy(dtype=np.float64)
            values = values[~np.isnan(values)]
            if len(values) and (values.min() < low or values.max() > high):
                left.append(signal)
    return left


@dataclass(frozen=True)
class _File(_Specification):
    """The keys of the TOML file."""

    schema: Literal[1]
    seconds: float
    commands: str
    commands_sha256: str


def write_experiment(folder: Path, experiment: Experiment) -> Path:
    """Write ``NAME.csv`` and then ``NAME.toml`` into ``folder``, each whole or not at all; returns the path of the latter."""
    folder.mkdir(parents=True, exist_ok=True)
    check_file_name(experiment.name, "experiment")
    text = io.StringIO()
    experiment.commands.to_csv(text, index=False, float_format="%.9g", lineterminator="\n")
    content = text.getvalue().encode()
    with written_whole(folder / f"{experiment.name}.csv") as half:
        half.write_bytes(content)
    path = folder / f"{experiment.name}.toml"
    with written_whole(path) as half:
        half.write_text(_toml(experiment, hashlib.sha256(content).hexdigest()), "utf-8")
    return path


def read_experiment(path: Path, machine: Machine | None = None) -> Experiment:
    """The experiment of ``NAME.toml``, checked.

    Args:
        machine: if given, the experiment has to be one for it.

    Raises:
        SettingsError: a wrong key or value, commands that are missing, changed, not finite, not on the grid of the stated rate
            or beyond their limits; or another machine's experiment.
    """
    file = load_settings(path, _File)
    check_file_name(file.name, f"{path}: name")
    where = inside(path.parent, file.commands, f"{path}: commands")
    if not where.is_file():
        raise SettingsError(f"{path}: commands", f"no such file {file.commands!r}", "the CSV file beside it")
    content = where.read_bytes()
    if hashlib.sha256(content).hexdigest() != file.commands_sha256:
        raise SettingsError(where, "its sha256 is not the one in the TOML file", "the commands as they were written")
    commands = pd.read_csv(io.BytesIO(content), dtype=np.float64)
    _check_commands(commands, file, where)
    if machine is not None:
        _check_machine(commands, file, machine, path)
    return Experiment(**{each.name: getattr(file, each.name) for each in fields(_Specification)}, commands=commands)


def _check_commands(commands: pd.DataFrame, file: _File, where: Path) -> None:
    if not len(commands) or not np.isfinite(commands.to_numpy()).all():
        raise SettingsError(where, "empty, or a value is not finite", "a number in every row of every column")
    grid = np.arange(len(commands)) / file.rate_hz
    if "time" not in commands.columns or np.abs(commands["time"].to_numpy() - grid).max() > 1e-3 / file.rate_hz:
        raise SettingsError(f"{where}: time", "is not k / rate_hz", f"0, {1.0 / file.rate_hz:g}, {2.0 / file.rate_hz:g} … s")
    if abs(len(commands) / file.rate_hz - file.seconds) > 0.5 / file.rate_hz:
        raise SettingsError(where, f"{len(commands) / file.rate_hz:g} s long", f"{file.seconds:g} s")
    for signal in outside(commands, file.limits):
        low, high = file.limits[signal]
        raise SettingsError(f"{where}: {signal}", "leaves its limits", f"{low:g} … {high:g}", "Do not execute this file.")


def _check_machine(commands: pd.DataFrame, file: _File, machine: Machine, path: Path) -> None:
    if file.machine != machine.name:
        raise SettingsError(f"{path}: machine", repr(file.machine), repr(machine.name))
    paths = [axis_signal(axis.name, "joint") for axis in machine.axes if axis.actuation == "force"]
    expected = ("time", *(axis_signal(axis.name, "command") for axis in machine.axes), *paths)
    for column in commands.columns:
        if column not in expected:
            raise SettingsError(f"{path}: commands", f"unknown column {column!r}", nearest(str(column), expected))
    missing = [column for column in expected if column not in commands.columns]
    if missing:
        raise SettingsError(f"{path}: commands", f"no column {missing[0]!r}", "one for every axis")
    for axis in file.axes:
        machine.axis(axis)


def _toml(experiment: Experiment, digest: str) -> str:
    lines = ["# A recording to make; docs/guide/next-experiment.md says how. SI units."]
    keys = ("name", "machine", "motion", "about", "axes", "seconds", "rate_hz", "repeats")
    top = {"schema": 1, **{key: getattr(experiment, key) for key in keys}}
    top |= {"commands": f"{experiment.name}.csv", "commands_sha256": digest}
    lines += [f"{key} = {toml_value(value)}" for key, value in top.items()]
    for key in ("start", "limits", "predicted", "provenance"):
        lines += ["", f"[{key}]"]
        lines += [f"{toml_key(name)} = {toml_value(value)}" for name, value in getattr(experiment, key).items()]
    for purpose in experiment.purposes:
        effects = ", ".join(f"{{name = {toml_value(e.name)}, target = {toml_value(e.target)}}}" for e in purpose.effects)
        lines += ["", "[[purposes]]", f"kind = {toml_value(purpose.kind)}", f"text = {toml_value(purpose.text)}"]
        lines += [f"effects = [{effects}]", f"nats = {toml_value(purpose.nats)}", f"needed = {toml_value(purpose.needed)}"]
    return "\n".join(lines) + "\n"
