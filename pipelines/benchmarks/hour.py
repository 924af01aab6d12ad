"""An hour of four axes, ingested: machine at 100 Hz, motion capture at 120 Hz on a clock that runs 40 ppm fast."""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.signal import butter, sosfiltfilt

from sysid.datasets import Dataset, ingest

Array = npt.NDArray[np.float64]

SITE = Path(__file__).resolve().parents[2] / "datasets" / "autolog"
SECONDS, MACHINE_RATE, CAPTURE_RATE = 3600.0, 100.0, 120.0
#: The capture's clock when the machine's is at zero [s], how much too fast it runs [ppm], and the noise of both [m or rad].
OFFSET, SKEW_PPM, WIRE_NOISE, CAPTURE_NOISE = 2.345, 40.0, 2e-5, 5e-4
#: Alignment and resampling of the hour have to be done within [s].
INGEST_LIMIT = 5.0

_STAGES = {
    "reading": "read",
    "aligning": "align",
    "resampling": "resample",
    "checking": "check",
    "describing": "check",
    "storing": "store",
}
_JOINTS = {"slew": 0.8, "boom": 0.35, "stick": 0.5, "telescope": 0.05}
_RECIPE = """schema = 1
machine = "machine.toml"
[[streams]]
files = "machine.parquet"
reader = "parquet"
domain = "machine"
[streams.signals]
{machine}
[[streams]]
files = "mocap.parquet"
reader = "parquet"
domain = "mocap"
secondary = ["telescope.joint"]
[streams.signals]
{mocap}
"""


def write_hour(folder: Path, seconds: float = SECONDS) -> Path:
    """A folder to ingest: band-limited random motion below 1 Hz, recorded twice. Returns the folder."""
    rng = np.random.default_rng(0)
    shutil.copy(SITE / "machine.toml", folder)
    shutil.copy(SITE / "autolog.urdf", folder)
    truth = np.arange(-1.0, seconds + 1.0, 0.01)
    band = butter(2, 1.0, fs=100.0, output="sos")
    moved = {}
    for joint, size in _JOINTS.items():
        motion = sosfiltfilt(band, rng.standard_normal(len(truth)))
        moved[joint] = size * motion / np.std(motion) / 2.0
    logs = folder / "logs" / "hour"
    logs.mkdir(parents=True)
    at = np.arange(round(seconds * MACHINE_RATE)) / MACHINE_RATE
    machine: dict[str, Array] = {"time": at}
    for joint, motion in moved.items():
        machine[f"{joint}.command"] = np.interp(at, truth, np.clip(np.gradient(motion, truth), -1.0, 1.0))
    for joint, name in (("boom", "boom.cylinder"), ("stick", "stick.cylinder"), ("telescope", "telescope.joint")):
        length = 0.05 + 0.03 * np.sin(moved[joint]) if name.endswith("cylinder") else moved[joint]
        machine[name] = np.interp(at, truth, length) + WIRE_NOISE * rng.standard_normal(len(at))
    seen = np.arange(round(seconds * CAPTURE_RATE)) / CAPTURE_RATE
    mocap: dict[str, Array] = {"time": seen * (1.0 + 1e-6 * SKEW_PPM) + OFFSET}
    for joint, motion in moved.items():
        mocap[f"{joint}.joint"] = np.interp(seen, truth, motion) + CAPTURE_NOISE * rng.standard_normal(len(seen))
    for name, table in (("machine", machine), ("mocap", mocap)):
        pd.DataFrame(table).to_parquet(logs / f"{name}.parquet")
    mapped = {
        name: "\n".join(f'"{column}" = {{ field = "{column}" }}' for column in table if column != "time")
        for name, table in (("machine", machine), ("mocap", mocap))
    }
    (folder / "recipe.toml").write_text(_RECIPE.format(**mapped), "utf-8")
    return folder


def ingested(folder: Path, workspace: Path) -> tuple[Dataset, dict[str, float]]:
    """The dataset, and the seconds that each stage took."""
    stages: dict[str, float] = {}
    current, since = "", time.perf_counter()

    def stage(_: float, text: str) -> None:
        nonlocal current, since
        now = time.perf_counter()
        if current:
            stages[current] = stages.get(current, 0.0) + now - since
        current, since = _STAGES.get(text.split()[0], ""), now

    dataset = ingest(folder / "logs", workspace, recipe=folder / "recipe.toml", progress=stage)
    return dataset, stages


def stage_seconds() -> dict[str, float]:
    """Seconds of each stage of an ingest of the hour; its clock is checked."""
    with tempfile.TemporaryDirectory(prefix="sysid-bench-") as scratch:
        folder = Path(scratch)
        (folder / "site").mkdir()
        dataset, stages = ingested(write_hour(folder / "site"), folder / "workspace")
    (record,) = dataset.clocks
    # The record says how the capture's stamps become the machine's, counted from the first of them.
    if record.skew_ppm is None or abs(record.skew_ppm + SKEW_PPM) > 1.0 or abs(record.offset_s) > 2e-3:
        raise SystemExit(f"the hour is aligned by {record.offset_s} s and {record.skew_ppm} ppm")
    return stages
