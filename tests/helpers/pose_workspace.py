"""A workspace with datasets of static poses of the crane, and a recipe whose forward network is fitted in a moment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from crane_data import dataset
from stored import small_dataset

from sysid.datasets.recording import Recording
from sysid.datasets.versions.manifest import PartRecord
from sysid.workspace import Workspace

UNITS = {
    "time": "s",
    **{f"{axis}.joint": "rad" for axis in ("slew", "boom", "stick")},
    **dict.fromkeys(("telescope.joint", "boom.cylinder", "stick.cylinder", "ee.x", "ee.y", "ee.z"), "m"),
}
QUICK = "[forward]\nhidden = [8]\n[forward.training]\nepochs = 4\nbatch = 16\n"


def pose_workspace(folder: Path, recordings: Mapping[str, Recording]) -> Workspace:
    """A workspace ``ws`` with a dataset of each recording, and ``quick.toml`` beside it."""
    found = Workspace(folder / "ws")
    _, channels = small_dataset(1)
    for number, (name, recording) in enumerate(recordings.items()):
        data = replace(dataset((recording,), {}), name=name, digest=f"{number:x}" * 64, units=UNITS)
        found.datasets.save(data, channels, PartRecord(1))
    (folder / "quick.toml").write_text(QUICK)
    return found
