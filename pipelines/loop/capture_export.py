"""The take of the motion capture during a run of the simulated test bench, as a Motive export beside the flight log."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from simulated_bench.capture import capture
from simulated_bench.machine import Truth
from simulated_bench.motive_export import wall_clock, write_motive
from simulated_bench.recipe import AXES, BenchRecipe, RecordingSettings

Array = npt.NDArray[np.float64]


def export_take(machine: BenchRecipe, truth: Mapping[str, Array], offset_ns: int, seed: int, folder: Path) -> None:
    """Write ``folder/mocap.csv``.

    Args:
        truth: columns of :data:`simulated_bench.live.COLUMNS`.
        offset_ns: from the clock of the truth to the date.
        seed: of the noise.
    """
    at = truth["at_ns"]
    count = len(at)
    motion = Truth(
        time=1e-9 * (at - at[0]),
        command=_columns(truth, [f"{name}.passed" for name in AXES]),
        drive=_columns(truth, [f"{name}.drive" for name in AXES]),
        joint=_columns(truth, [f"{name}.joint" for name in AXES]),
        ee=_columns(truth, [f"ee.{letter}" for letter in "xyz"]),
        tool=_columns(truth, [f"tool.{letter}" for letter in "xyz"]),
        still=np.zeros((0, 2)),
        pressure=np.zeros((count, 2 * len(AXES) + 1)),
        friction=np.zeros((count, len(AXES))),
    )
    recording = RecordingSettings("flight", seed=seed, seconds=float(motion.time[-1]))
    take = capture(machine, recording, motion, np.random.default_rng([machine.seed, seed, 2]))
    started = wall_clock(round(offset_ns + at[0]), take.clock.offset)
    write_motive(take, folder / "mocap.csv", folder.name, started, machine.capture.capture_rate)


def _columns(truth: Mapping[str, Array], names: list[str]) -> Array:
    return np.column_stack([truth[name] for name in names])
