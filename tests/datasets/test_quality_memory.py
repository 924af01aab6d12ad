"""Quality of a long recording: what it holds beside the table is less than the table, and figures are computed once."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pandas as pd

from sysid.datasets import Dataset, Recording
from sysid.datasets.checks.run import check_plausibility
from sysid.datasets.quality.evidence import evidence_of
from sysid.machine import machine_from_files

#: Samples, and the most that may be held beside the table, for each byte of it.
ROWS, TIMES = 1_500_000, 1.2
MACHINE = """schema = 1
name = "slide"
rate_hz = 1000.0
[[axes]]
name = "slide"
actuation = "velocity"
drives = "joint"
gain = 0.1
limits = [-0.5, 0.5]
"""


def long_dataset() -> Dataset:
    rng = np.random.default_rng(5)
    command = np.repeat(rng.choice([-1.0, -0.3, 0.0, 0.3, 1.0], ROWS // 1000), 1000)
    command -= np.repeat(np.cumsum(command[::1000]) > 0.0, 1000) * 0.2
    table = {"time": np.arange(ROWS) / 1000.0, "slide.command": command}
    joint = 0.4 * np.sin(1e-4 * np.cumsum(command)) + 2e-5 * rng.standard_normal(ROWS)
    machine = machine_from_files({"machine.toml": MACHINE}, "machine.toml")
    return Dataset.of(machine, [Recording("long", pd.DataFrame({**table, "slide.joint": joint}), 1000.0)])


def test_memory_beside_the_table() -> None:
    dataset = long_dataset()
    size = 3 * 8 * ROWS
    tracemalloc.start()
    try:
        evidence_of(dataset)
        check_plausibility(dataset)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < TIMES * size, f"{most / size:.2f}"
