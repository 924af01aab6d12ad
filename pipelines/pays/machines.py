"""Machines of the comparison: recordings to learn from, recordings to predict, and the lengths that are compared."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from simulated_bench.case import overlaid
from simulated_bench.recipe import AXES, BenchRecipe, RecordingSettings
from simulated_bench.run import simulate
from sysid.config import parse_settings, read_toml
from sysid.datasets import Dataset, Recording, Role, ingest
from sysid.datasets.chunked import stretches
from sysid.gap.prepare.noise import noise_of_signals
from sysid.machine import Machine, load_machine

Array = npt.NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[2]
DATASETS = ROOT / "datasets"
#: Start of each test recording that no model is evaluated on [s]: networks need its history, plants its start.
WARM_UP = 1.0
#: End of each stretch that no model is evaluated on [s]: the last step of a network ends within it.
TAIL = 0.2
#: Length of the short free runs, besides those over whole recordings [s].
PIECE = 2.0
#: A shorter test recording is left out [s]: most of it would be its start.
LEAST_TEST = 10.0
#: Own bench: recordings to learn from and to predict, and their length [s].
BENCH_TRAINING, BENCH_TEST, BENCH_SECONDS = 4, 2, 60.0


@dataclass(frozen=True)
class MeasuredSet:
    """One axis of a measured set.

    Args:
        name: of its recipe in ``datasets/``. folder: of the raw files.
        lengths: seconds that are learned from; what is beyond the recordings is all of them.
        unit: SI unit of the motion; empty where the source does not say.
    """

    name: str
    title: str
    folder: str
    axis: str
    lengths: tuple[float, ...]
    unit: str


#: In the order of their cost.
MEASURED = (
    MeasuredSet("hydraulic_actuator", "hydraulic actuator", "hyd_actuator", "arm", (4.0, 8.0, 16.0, np.inf), ""),
    MeasuredSet("emps", "EMPS", "emps", "slide", (3.0, 6.0, 14.0, np.inf), "m"),
    MeasuredSet("rc_excavator", "RC excavator, bucket", "rc_excavator", "bucket", (10.0, 20.0, 39.0, 80.0, np.inf), "m"),
    MeasuredSet("so101", "SO-101, elbow", "sage_so101", "elbow", (10.0, 30.0, 90.0, np.inf), "rad"),
)
#: What the drive of the boom of the bench crane hides, besides its dead-band.
BENCH: dict[str, dict[str, Any]] = {"bench, dead-band and uneven drive": {"uneven": 0.3, "pitch": 0.03}}
BENCH_LENGTHS = (15.0, 60.0, 120.0, np.inf)


@dataclass(frozen=True)
class Source:
    """What every model of one machine learns from, and what it is evaluated on.

    Args:
        training: in the order in which they were recorded. held_out: recordings that no fit has seen. test: those of them on
            which models are evaluated.
        lengths: seconds, increasing; the last one is all of ``training``.
    """

    title: str
    machine: Machine
    axis: str
    training: tuple[Recording, ...]
    held_out: tuple[Recording, ...]
    lengths: tuple[float, ...]
    unit: str

    @property
    def command(self) -> str:
        return f"{self.axis}.command"

    @property
    def test(self) -> tuple[Recording, ...]:
        return tuple(r for r in self.held_out if seconds_of([r]) >= LEAST_TEST)

    @property
    def signal(self) -> str:
        """The motion that is predicted."""
        return self.machine.axis(self.axis).driven


def measured_source(item: MeasuredSet, raw: Path, workspace: Path) -> Source:
    """A measured set, as its recipe reads it: learned from what it does not hold out."""
    data = ingest(raw / item.folder, workspace, recipe=DATASETS / item.name / "recipe.toml")
    signals = [f"{item.axis}.command", data.machine.axis(item.axis).driven]
    # A property of the sensor, which ingest finds in its own samples: stated, so that no length changes it.
    noise = {name: each.level for name, each in noise_of_signals(data).items() if name == signals[1]}
    machine = replace(data.machine, noise=data.machine.noise | noise)
    return source(
        item.title,
        machine,
        item.axis,
        data.with_role("fit", "select"),
        data.with_role("held_out"),
        signals,
        item.lengths,
        item.unit,
    )


def bench_source(title: str) -> Source:
    """The boom of the crane in ``datasets/autolog``, recorded at the rate of its controller by its draw wire."""
    tables = overlaid(read_toml(DATASETS / "autolog" / "bench.toml"), {"axes": {"boom": {"irregular": BENCH[title]}}})
    recipe = parse_settings({**tables, "recordings": []}, BenchRecipe, title)
    recordings = []
    for number in range(BENCH_TRAINING + BENCH_TEST):
        log = simulate(recipe, RecordingSettings(f"run-{number}", seed=500 + number, seconds=BENCH_SECONDS)).log
        table = {"time": np.arange(len(log.stamps)) / recipe.controller.rate}
        table |= {"boom.command": log.command[:, AXES.index("boom")], "boom.cylinder": log.wires[:, 0]}
        recordings.append(Recording(f"run-{number}", pd.DataFrame(table), recipe.controller.rate))
    training, test = recordings[:BENCH_TRAINING], recordings[BENCH_TRAINING:]
    machine = load_machine(DATASETS / "autolog" / "machine.toml")
    return source(title, machine, "boom", training, test, ["boom.command", "boom.cylinder"], BENCH_LENGTHS, "m")


def source(
    title: str, machine: Machine, axis: str, training: Iterable[Recording], held_out: Iterable[Recording],
    signals: Sequence[str], lengths: Sequence[float], unit: str,
) -> Source:  # fmt: skip
    """The recordings with the signals of the axis alone, and the lengths that they have."""
    kept, proof = ([replace(r, table=r.table[["time", *signals]]) for r in parts] for parts in (training, held_out))
    whole = seconds_of(kept)
    shorter = tuple(length for length in lengths if length < whole)
    return Source(title, machine, axis, tuple(kept), tuple(proof), (*shorter, whole), unit)


def seconds_of(recordings: Iterable[Recording]) -> float:
    """Length of recordings together [s]."""
    return float(sum(len(r) / r.rate_hz for r in recordings))


def leading(recordings: Sequence[Recording], seconds: float) -> tuple[Recording, ...]:
    """The first ``seconds`` of recordings, one after the other; the last one is cut."""
    found, left = [], seconds
    for recording in recordings:
        rows = min(len(recording), round(left * recording.rate_hz))
        if rows > 0:
            found.append(rows_of(recording, 0, rows, recording.name))
        left -= rows / recording.rate_hz
    return tuple(found)


def pieces(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """Recordings cut into runs of :data:`PIECE` after a warm-up; what is left over at their ends is not in one."""
    found = []
    for recording in recordings:
        rows = round((WARM_UP + PIECE + TAIL) * recording.rate_hz)
        starts = range(0, len(recording) - rows + 1, round(PIECE * recording.rate_hz))
        found += [rows_of(recording, start, start + rows, f"{recording.name} {start}") for start in starts]
    return tuple(found)


def rows_of(recording: Recording, start: int, stop: int, name: str) -> Recording:
    """Rows ``start`` to ``stop`` (excluded), with a time of their own."""
    table = recording.table.iloc[start:stop].reset_index(drop=True)
    return replace(recording, name=name, table=table.assign(time=np.arange(len(table)) / recording.rate_hz))


def in_blocks(machine: Machine, recordings: Sequence[Recording], shares: Sequence[tuple[Role, float]]) -> Dataset:
    """Every recording cut into contiguous blocks of these shares and roles, in this order."""
    parts, roles = list[Recording](), dict[str, Role]()
    for recording in recordings:
        edges = np.round(np.cumsum([0.0, *(share for _, share in shares)]) * len(recording)).astype(int)
        for (role, _), start, stop in zip(shares, edges, edges[1:], strict=False):
            block = rows_of(recording, int(start), int(stop), f"{recording.name} {role}")
            parts.append(block)
            roles[block.name] = role
    return Dataset.of(machine, parts, roles)


def evaluated_rows(recording: Recording, command: str, signal: str) -> npt.NDArray[np.bool_]:
    """The rows with a measurement of each stretch without a gap in the command, without its warm-up and its tail, (n,)."""
    found = np.zeros(len(recording), dtype=bool)
    for start, stop in zip(*stretches(np.isfinite(recording.values(command))), strict=True):
        first, last = start + round(WARM_UP * recording.rate_hz), stop - round(TAIL * recording.rate_hz)
        found[first : max(last, first)] = True
    return found & np.isfinite(recording.values(signal))
