"""A workspace with one of everything: two dataset versions, networks, plants, a gap result, and a damaged one."""

from __future__ import annotations

import atexit
import functools
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

from sample_crane import sample_dataset, sample_gap
from stored import small_dataset
from version_data import actuator

from sysid.datasets.versions.manifest import PartRecord
from sysid.gap.stored_result import save_gap
from sysid.networks import NetworkRecipe
from sysid.plant import nominal_plant
from sysid.workspace import Workspace, open_workspace


def sample_workspace(folder: Path) -> Workspace:
    """A copy of :func:`_made`, which takes a while."""
    shutil.copytree(_made(), folder, dirs_exist_ok=True)
    return open_workspace(folder)


@functools.cache
def _made() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="sysid-sample-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    _make(folder)
    return folder


def _make(folder: Path) -> None:
    """``autolog@1`` with a gap result that created plant ``autolog@2``, the champion; ``autolog@2`` split from it."""
    place = open_workspace(folder)
    channels = small_dataset(1)[1]
    sample = sample_dataset(12.0)
    clocks = tuple(clock for clock in sample.clocks if not clock.applied)  # the channels of the others are not stored
    own = place.datasets.save(replace(sample, version=0, clocks=clocks), channels, PartRecord(1))
    place.datasets.resplit(own.reference, {**own.splits, "manual-01": "held_out"})
    for off in (0.0, 0.002):
        place.add_network(own, actuator("boom", off=off), NetworkRecipe())
    plant = nominal_plant(own.machine, place.linkages(own), own.streams)
    lineage = {"dataset": own.reference, "dataset_digest": own.digest, "networks": "autolog-actuator@2"}
    before = place.models.register("autolog", "plant", plant.to_files(), lineage)
    result = sample_gap(own)
    effects = [{"name": e.name, "target": e.target, "parameters": dict(e.parameters)} for e in result.effects]
    repaired = {**lineage, "plant": before.reference, "effects": effects}
    after = place.models.register("autolog", "plant", plant.to_files(), repaired)
    place.models.promote(after.reference)
    stored = replace(result, dataset=own.reference, plant_before=before.reference, plant_after=after.reference)
    save_gap(place.gap_folder(own), stored)
    broken = place.gap_folder(own).parent.with_name("autolog@2") / "gap"
    broken.mkdir(parents=True)
    (broken / "result.json").write_text('{"plant": {"before": "autolog@1"')
