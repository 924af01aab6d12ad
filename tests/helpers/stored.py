"""Small datasets for tests of the store, without logs."""

from __future__ import annotations

import numpy as np
import pandas as pd

from sysid.datasets import Dataset, Recording, Source
from sysid.datasets.channel import Channel
from sysid.machine import machine_from_files

MACHINE = """schema = 1
name = "demo"
rate_hz = 100.0
[[axes]]
name = "a"
actuation = "velocity"
drives = "joint"
"""

Channels = dict[str, tuple[Channel, ...]]


def small_dataset(seed: int, name: str = "demo", recordings: int = 2, rows: int = 50) -> tuple[Dataset, Channels]:
    """A dataset whose numbers, names and digest follow from ``seed``, with its raw channels."""
    rng = np.random.default_rng(seed)
    made, channels = [], {}
    for index in range(recordings):
        title = f"s{seed}-r{index}"
        values = rng.normal(size=rows)
        values[3] = np.nan
        time = np.arange(rows) / 100.0
        table = pd.DataFrame({"time": time, "a.command": rng.uniform(-1, 1, rows), "a.joint": values})
        table.attrs["units"] = {"time": "s", "a.command": "1", "a.joint": "rad"}
        made.append(Recording(title, table, 100.0, "motion", 10**18 + index))
        channels[title] = (Channel("a.joint", "log.csv", "machine", np.arange(rows) * 10**7, values, "rad"),)
    dataset = Dataset(
        name=name,
        version=0,
        digest=f"{seed:064x}",
        machine=machine_from_files({"machine.toml": MACHINE}, "test"),
        recordings=tuple(made),
        units={"time": "s", "a.command": "1", "a.joint": "rad"},
        splits={recording.name: "held_out" if index else "fit" for index, recording in enumerate(made)},
        sources=tuple(
            Source(f"{recording.name}/log.csv", f"{seed:062x}{index:02x}", 10) for index, recording in enumerate(made)
        ),
        quality={"recordings": {recording.name: {"seconds": rows / 100.0} for recording in made}},
        streams={"log": ("a.command", "a.joint")},
    )
    return dataset, channels
