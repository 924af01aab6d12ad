"""The wrong-unit matrix: seven mistakes in each of five kinds of signal, on datasets whose units are right.

A mistake is applied to the tables or to the text of ``machine.toml`` and the URDF. Mistakes in the stamps go through ingest,
since they change the tables that it makes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sysid.datasets import Dataset, Recording, ingest
from sysid.datasets.checks.finding import Finding
from sysid.datasets.checks.run import check_plausibility
from sysid.machine import machine_from_files

Array = npt.NDArray[np.float64]
Change = Callable[[Array], Array]
DEGREES = 180.0 / math.pi


@dataclass(frozen=True)
class Cell:
    """One mistake in one signal.

    Args:
        signal: ``command``, ``cylinder``, ``joint``, ``ee`` or ``time``.
        factor: that a cause has to have; −1: a sign; 0: an exchange of columns; NaN: a raw value with a neutral point.
        named: words that the cause has to contain, one at least.
        make: dataset → dataset with the mistake.
    """

    signal: str
    mistake: str
    factor: float
    named: tuple[str, ...]
    make: Callable[[Dataset, Path], Dataset]

    def caught(self, findings: tuple[Finding, ...]) -> bool:
        """Whether one of the findings names the factor and where it is."""
        return any(
            self._factor(cause.factor) and any(word in cause.text for word in self.named)
            for finding in findings
            for cause in finding.causes
        )

    def _factor(self, found: float) -> bool:
        if math.isnan(self.factor) or self.factor == 0.0:
            return True
        return abs(found / self.factor - 1.0) < 0.03


def changed(dataset: Dataset, columns: dict[str, Change]) -> Dataset:
    """The dataset with changed columns."""
    recordings = []
    for recording in dataset.recordings:
        there = {name: change(recording.values(name)) for name, change in columns.items() if name in recording.signals}
        recordings.append(replace(recording, table=recording.table.assign(**there)))
    return replace(dataset, recordings=tuple(recordings))


def exchanged(dataset: Dataset, a: str, b: str) -> Dataset:
    """The dataset with two columns exchanged."""
    recordings = tuple(replace(r, table=r.table.rename(columns={a: b, b: a})) for r in dataset.recordings)
    return replace(dataset, recordings=recordings)


def described(dataset: Dataset, change: Callable[[str], str], urdf: Callable[[str], str] | None = None) -> Dataset:
    """The dataset with another ``machine.toml`` or URDF."""
    files = dataset.machine.files()
    texts = {name: change(text) if name == "machine.toml" else urdf(text) if urdf else text for name, text in files.items()}
    assert texts != files, "nothing was changed"
    return replace(dataset, machine=machine_from_files(texts, "wrong"))


def times(key: str, factor: float, axis: str = "") -> Callable[[str], str]:
    """``machine.toml`` with the numbers of a key multiplied, of one axis or of all."""

    def change(text: str) -> str:
        head, *tables = re.split(r"(?=^\[\[axes\]\])", text, flags=re.MULTILINE)
        pattern = re.compile(rf"^({key} *= *)(\[[^\]]*\]|[-\d.e]+)", re.MULTILINE)

        def multiplied(match: re.Match[str]) -> str:
            return match[1] + re.sub(r"-?\d+\.?\d*(?:e-?\d+)?", lambda number: repr(float(number[0]) * factor), match[2])

        if not tables or key == "rate_hz":
            return pattern.sub(multiplied, text, count=1)
        tables = [pattern.sub(multiplied, table) if not axis or f'name = "{axis}"' in table else table for table in tables]
        return "".join((head, *tables))

    return change


def urdf_lengths(factor: float) -> Callable[[str], str]:
    """A URDF with other lengths: all its origins."""

    def scaled(match: re.Match[str]) -> str:
        return 'xyz="' + " ".join(repr(float(word) * factor) for word in match[1].split()) + '"'

    return lambda text: re.sub(r"<origin[^>]*>", lambda tag: re.sub(r'xyz="([^"]*)"', scaled, tag[0]), text)


def with_other_stamps(dataset: Dataset, folder: Path, factor: float, change: Callable[[str], str] | None = None) -> Dataset:
    """The dataset written as CSV files with stamps times ``factor`` and ingested again."""
    logs = folder / "logs"
    for recording in dataset.of_kind("motion"):
        place = logs / recording.name.replace("#", "-")
        place.mkdir(parents=True)
        table = recording.table.copy()
        table["time"] = table["time"] * factor
        table.to_csv(place / "log.csv", index=False)
    for name, text in dataset.machine.files().items():
        changed_text = change(text) if change is not None and name == "machine.toml" else text
        (folder / name).write_text(changed_text, "utf-8")
    return ingest(logs, folder / "workspace", machine=folder / "machine.toml")


def scale(signal: str, factor: float) -> Callable[[Dataset, Path], Dataset]:
    return lambda dataset, _: changed(dataset, {signal: lambda values: values * factor})


def swap(a: str, b: str) -> Callable[[Dataset, Path], Dataset]:
    return lambda dataset, _: exchanged(dataset, a, b)


def stamps(factor: float) -> Callable[[Dataset, Path], Dataset]:
    return lambda dataset, folder: with_other_stamps(dataset, folder, factor)


def command_cells(axis: str, other: str) -> Iterator[Cell]:
    """Of a valve."""
    signal = f"{axis}.command"
    for name, factor in (
        ("per cent as fraction", 100.0),
        ("per mille as fraction", 1000.0),
        ("counts of 8 bits as fraction", 127.0),
        ("fraction as per cent", 0.01),
    ):
        yield Cell("command", name, factor, (signal,), scale(signal, factor))
    duty: Change = lambda u: 7.5 + 2.5 * u  # noqa: E731
    make: Callable[[Dataset, Path], Dataset] = lambda dataset, _: changed(dataset, {signal: duty})  # noqa: E731
    yield Cell("command", "duty cycle with its neutral point", math.nan, (f"{signal} is a raw value",), make)
    yield Cell("command", "sign", -1.0, (signal,), scale(signal, -1.0))
    yield Cell(
        "command",
        "exchanged columns",
        0.0,
        (f"{axis}.command and {other}.command", f"{other}.command and {axis}.command"),
        swap(signal, f"{other}.command"),
    )


def setpoint_cells(axis: str, other: str) -> Iterator[Cell]:
    """Commands of a servo [rad]."""
    yield from _angle_cells("command", axis, other)
    signal = f"{axis}.command"
    yield Cell("command", "encoder counts as rad", 4096 / (2 * math.pi), (signal,), scale(signal, 4096 / (2 * math.pi)))


def force_cells(axis: str) -> Iterator[Cell]:
    signal = f"{axis}.command"
    yield Cell("command", "N as kN", 1000.0, (signal,), scale(signal, 1000.0))
    yield Cell("command", "kN as N", 0.001, (signal,), scale(signal, 0.001))
    yield Cell("command", "sign", -1.0, (signal,), scale(signal, -1.0))
    yield Cell(
        "command", "inertia in g in machine.toml", 1000.0, ("inertia",), lambda d, _: described(d, times("inertia", 1e3))
    )


def cylinder_cells(axis: str, other: str) -> Iterator[Cell]:
    signal = f"{axis}.cylinder"
    for name, factor in (("mm as m", 1000.0), ("cm as m", 100.0), ("mm as cm", 10.0), ("cm as mm", 0.1)):
        yield Cell("cylinder", name, factor, (signal,), scale(signal, factor))
    yield Cell("cylinder", "sign", -1.0, (signal,), scale(signal, -1.0))
    names = (f"{axis}.cylinder and {other}.cylinder", f"{other}.cylinder and {axis}.cylinder")
    yield Cell("cylinder", "exchanged columns", 0.0, names, swap(signal, f"{other}.cylinder"))

    def in_mm(dataset: Dataset, _: Path) -> Dataset:
        return described(dataset, lambda text: times("stroke", 1e3, axis)(times("gain", 1e3, axis)(text)))

    yield Cell("cylinder", "gain and stroke in mm in machine.toml", 1000.0, ("`gain` and `stroke`",), in_mm)


def joint_cells(axis: str, other: str, in_description: Cell | None) -> Iterator[Cell]:
    yield from _angle_cells("joint", axis, other)
    if in_description is not None:
        yield in_description


def _angle_cells(quantity: str, axis: str, other: str) -> Iterator[Cell]:
    signal = f"{axis}.{quantity}"
    for name, factor in (
        ("degrees as rad", DEGREES),
        ("rad as degrees", 1.0 / DEGREES),
        ("mrad as rad", 1000.0),
        ("rad as turns", 2.0 * math.pi),
    ):
        yield Cell(quantity, name, factor, (signal,), scale(signal, factor))
    yield Cell(quantity, "sign", -1.0, (signal,), scale(signal, -1.0))
    if other:
        names = (f"{axis}.{quantity} and {other}.{quantity}", f"{other}.{quantity} and {axis}.{quantity}")
        yield Cell(quantity, "exchanged columns", 0.0, names, swap(signal, f"{other}.{quantity}"))


def length_joint_cells(axis: str) -> Iterator[Cell]:
    """A joint that moves along a line [m]."""
    signal = f"{axis}.joint"
    for name, factor in (("mm as m", 1000.0), ("cm as m", 100.0), ("mm as cm", 10.0), ("m as mm", 0.001)):
        yield Cell("joint", name, factor, (signal,), scale(signal, factor))
    yield Cell("joint", "sign", -1.0, (signal,), scale(signal, -1.0))
    yield Cell("joint", "limits in mm in machine.toml", 1000.0, ("`limits`",), lambda d, _: described(d, times("limits", 1e3)))


def ee_cells() -> Iterator[Cell]:
    def whole(factor: float) -> Callable[[Dataset, Path], Dataset]:
        return lambda dataset, _: changed(dataset, {f"ee.{c}": lambda values: values * factor for c in "xyz"})

    for name, factor in (("mm as m", 1000.0), ("cm as m", 100.0), ("inch as m", 39.37), ("m as mm", 0.001)):
        yield Cell("ee", name, factor, ("ee.x",), whole(factor))
    yield Cell("ee", "sign of one coordinate", -1.0, ("ee.x",), scale("ee.x", -1.0))
    yield Cell("ee", "exchanged columns", 0.0, ("coordinates of ee are exchanged",), swap("ee.x", "ee.z"))
    yield Cell("ee", "lengths of the URDF in mm", 1000.0, ("URDF",), lambda d, _: described(d, str, urdf_lengths(1e3)))


def time_cells() -> Iterator[Cell]:
    for name, factor in (
        ("ms as s", 1e3),
        ("µs as s", 1e6),
        ("s as ms", 1e-3),
        ("s as µs", 1e-6),
        ("min as s", 1.0 / 60.0),
    ):
        yield Cell("time", name, factor, ("time stamps",), stamps(factor))
    yield Cell("time", "rate_hz in mHz", 1e3, ("rate_hz",), lambda d, f: with_other_stamps(d, f, 1.0, times("rate_hz", 1e3)))


def caught(cell: Cell, dataset: Dataset, folder: Path) -> tuple[bool, tuple[Finding, ...] | str]:
    """Whether a mistake is caught with its factor, and what was found: findings, or the refusal of the ingest."""
    from sysid.errors import SysidError

    try:
        findings = check_plausibility(cell.make(dataset, folder))
    except SysidError as error:
        words = ("time_unit", *cell.named) if cell.signal == "time" else cell.named
        return any(word in str(error) for word in words) and _factor_in(cell.factor, str(error)), str(error)
    return cell.caught(findings), findings


def _factor_in(factor: float, text: str) -> bool:
    """Whether a refusal names the factor, or the unit of the stamps that it means."""
    size = factor if factor > 1.0 else 1.0 / factor
    unit = {1_000: "ms", 1_000_000: "us", 1_000_000_000: "ns"}.get(round(size), "no unit")
    return f"factor of {size:.0f}" in text or f"expected {unit} (" in text


def cut(dataset: Dataset, seconds: float) -> Dataset:
    """The first seconds of the recordings of motion."""
    shorter = [
        Recording(r.name, r.table.iloc[: round(seconds * r.rate_hz)].reset_index(drop=True), r.rate_hz, r.kind, r.start_ns)
        for r in dataset.of_kind("motion")
    ]
    return replace(dataset, recordings=(*shorter, *dataset.of_kind("poses")))


# -- machines ---------------------------------------------------------------------------------------------------------------


def servo_arm(folder: Path) -> Dataset:
    """The servo arm of the simulated test bench, with its end effector by the formula of a planar arm."""
    from simulated_bench.joint_machines import write_joint_machine
    from simulated_bench.joint_recipe import ServoArm, ServoAxis, Take

    shoulder = ServoAxis("shoulder", (-0.5, 1.5), 0.3, 1.0, delay=0.02, time_constant=0.04)
    elbow = ServoAxis("elbow", (-2.0, 0.5), 0.25, 0.6, delay=0.02, time_constant=0.03)
    takes = tuple(Take(f"take-{k}", k, 20.0) for k in range(4))
    write_joint_machine(ServoArm("servo_arm", "arm", 1, (shoulder, elbow), takes, noise=1e-4), folder / "arm")
    dataset = ingest(folder / "arm", folder / "workspace")
    recordings = []
    for seed, recording in enumerate(dataset.recordings):
        first = recording.values("shoulder.joint")
        second = first + recording.values("elbow.joint")
        noise = np.random.default_rng(seed).normal(0.0, 2e-4, (3, len(first)))
        x, z = 0.3 * np.cos(first) + 0.25 * np.cos(second), 0.3 * np.sin(first) + 0.25 * np.sin(second)
        table = recording.table.assign(**{"ee.x": x + noise[0], "ee.y": noise[1], "ee.z": z + noise[2]})
        recordings.append(replace(recording, table=table))
    return replace(dataset, recordings=tuple(recordings))


def slide(folder: Path) -> Dataset:
    """The slide of the simulated test bench, moved by a force."""
    from simulated_bench.joint_machines import write_joint_machine
    from simulated_bench.joint_recipe import Slide, Take

    takes = tuple(Take(f"take-{k}", k, 10.0) for k in range(4))
    machine = Slide("slide", "slide", 1, 80.0, takes, coulomb=15.0, viscous=150.0, noise=1e-6, force_noise=0.5)
    write_joint_machine(machine, folder / "slide")
    return ingest(folder / "slide", folder / "workspace")


def crane_cells() -> list[Cell]:
    """The shipped crane: cylinders, joints of both kinds, end effector."""

    def in_degrees(dataset: Dataset, _: Path) -> Dataset:
        return described(dataset, times("gain", DEGREES, "slew"))

    gain = Cell("joint", "gain in degrees/s in machine.toml", DEGREES, ("`gain`",), in_degrees)
    return [
        *command_cells("boom", "stick"),
        *cylinder_cells("boom", "stick"),
        *joint_cells("boom", "stick", gain),
        *ee_cells(),
        *time_cells(),
    ]


def arm_cells() -> list[Cell]:
    """The servo arm has no cylinder; its position axes have no gain and no sign in machine.toml."""
    turned: Callable[[str], str] = lambda text: re.sub(  # noqa: E731
        r'(lower|upper)="([-\d.]+)"', lambda match: f'{match[1]}="{float(match[2]) * DEGREES}"', text
    )
    limits = Cell("joint", "limits in degrees in the URDF", DEGREES, ("`limits`",), lambda d, _: described(d, str, turned))
    return [*setpoint_cells("shoulder", "elbow"), *joint_cells("shoulder", "elbow", limits), *ee_cells(), *time_cells()]


def slide_cells() -> list[Cell]:
    """The slide has one axis (nothing to exchange), no cylinder and no end effector."""
    return [*force_cells("carriage"), *length_joint_cells("carriage"), *time_cells()]


def excavator_cells() -> list[Cell]:
    """The RC excavator: three cylinders and their commands."""
    return [*command_cells("boom", "stick"), *cylinder_cells("boom", "stick"), *time_cells()]
