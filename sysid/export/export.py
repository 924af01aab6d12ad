"""The list of export targets, and the export of a plant: write the files, replay them, keep them if they agree with the
plant.
"""

from __future__ import annotations

import json
import shutil
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

from sysid.datasets.recording import Dataset, Recording
from sysid.errors import SettingsError, nearest, written_to
from sysid.export.fmu import FmuTarget
from sysid.export.isaaclab import IsaacLabTarget
from sysid.export.json_target import JsonTarget
from sysid.export.lut import LutTarget
from sysid.export.mjcf import MjcfTarget
from sysid.export.mjcf_servo import has_servos
from sysid.export.names import Renamed
from sysid.export.newton import NewtonTarget
from sysid.export.page import export_page, lacking, shown, unit_of
from sysid.export.posterior import posterior, write_posterior
from sysid.export.replay import Replay, force_replay, replay
from sysid.export.sdf import SdfTarget
from sysid.export.simulink import SimulinkTarget
from sysid.export.target import ForceSimulation, Simulation, Target
from sysid.export.urdf import UrdfTarget
from sysid.files import make_folder
from sysid.gap.prepare.noise import noise_levels
from sysid.machine.rigid_body import moves_masses
from sysid.plant import Plant

TARGETS: tuple[Target, ...] = (
    MjcfTarget(), UrdfTarget(), SdfTarget(), IsaacLabTarget(), NewtonTarget(), FmuTarget(), SimulinkTarget(), LutTarget(),
    JsonTarget(),
)  # fmt: skip


def target_named(name: str) -> Target:
    """The target of ``sysid export --to NAME``.

    Raises:
        SettingsError: no target has that name.
    """
    names = [target.name for target in TARGETS]
    if name not in names:
        raise SettingsError("sysid export", f"no target {name!r}", nearest(name, names))
    return TARGETS[names.index(name)]


def fallback(target: Target, plant: Plant) -> Target | None:
    """A variant that leaves more to the drive model, for an export that does not agree with the plant; None without."""
    if not isinstance(target, MjcfTarget) or target.most == "plugin" or moves_masses(plant.machine):
        return None
    return MjcfTarget("native" if target.most == "composed" else "plugin")


REPLAY, PAGE = "replay.json", "README.md"
NOT_INSTALLED = "Not run here: the simulator is not installed. The files were checked against their format alone."
#: Draws of the parameters that are written.
SAMPLES, SEED = 1000, 0


@dataclass(frozen=True)
class Export:
    """A written export.

    Args:
        files: names in ``folder``, the main one first.
        replay: None where it was not run; ``unreplayed``: why.
        lacking: effects that the target cannot represent.
        renamed: parts of the machine that have other names in the files.
    """

    plant: str
    target: str
    folder: Path
    files: tuple[str, ...]
    replay: Replay | None
    lacking: tuple[str, ...]
    renamed: tuple[Renamed, ...] = ()
    unreplayed: str = NOT_INSTALLED

    def to_json(self) -> dict[str, Any]:
        return {
            "schema": 1,
            "plant": self.plant,
            "target": self.target,
            "folder": str(self.folder),
            "files": list(self.files),
            "not_representable": list(self.lacking),
            "renamed": [asdict(part) for part in self.renamed],
            "replay": None if self.replay is None else self.replay.to_json(),
            "not_replayed": self.unreplayed if self.replay is None else "",
        }


def export_plant(
    plant: Plant,
    dataset: Dataset | None,
    target: Target,
    folder: Path,
    *,
    force: bool = False,
    samples: int = SAMPLES,
    seed: int = SEED,
    beside: Callable[[Path], tuple[str, ...]] = lambda folder: (),
    unreplayed: str = NOT_INSTALLED,
) -> Export:
    """Write a plant for another simulator.

    Args:
        dataset: its held-out recordings are replayed; None: nothing is, and ``unreplayed`` says why.
        folder: new, empty, or that of an earlier export, which is replaced.
        force: keep an export that does not agree with the plant.
        samples, seed: draws of the parameters.
        beside: writes further files into the folder and returns their names.

    Raises:
        SettingsError: the folder contains something else, the target cannot represent the machine, or the export does not agree
            with the plant; nothing is left then.
        ExcitationError: no held-out recording can be replayed.
    """
    check_folder(folder)
    if dataset is not None:  # it may have another rate than that from which the plant comes; files and replay have one
        plant = replace(plant, machine=replace(plant.machine, rate_hz=dataset.machine.rate_hz))
    reference, rate = plant.reference or plant.machine.name, plant.machine.rate_hz
    if not target.arms:
        _check_arms(plant, f"export of {reference} to {target.name}")
    make_folder(folder.parent)
    half = folder.with_name(f".{folder.name}.{uuid.uuid4().hex[:8]}.part")

    def write(target: Target) -> Export:
        half.mkdir()
        files = (*target.write(plant, rate, half), *write_posterior(posterior(plant, samples, seed), half), *beside(half))
        names, lacks, renamed = (*files, REPLAY, PAGE), tuple(lacking(plant, target)), target.names(plant).changed
        found = None if dataset is None else _replayed(plant, target, half, dataset)
        source, units = (None, {}) if dataset is None else (dataset.reference, dataset.units)
        made = Export(reference, target.name, folder, names, found, lacks, renamed, unreplayed)
        (half / REPLAY).write_text(json.dumps({**made.to_json(), "dataset": source}, indent=1), "utf-8")
        (half / PAGE).write_text(export_page(plant, target, rate, names, found or unreplayed, units), "utf-8")
        shutil.rmtree(half / "__pycache__", ignore_errors=True)
        return made

    try:
        with written_to(half, folder):
            found = write(target)
            while found.replay is not None and not found.replay.agrees and (simpler := fallback(target, plant)) is not None:
                shutil.rmtree(half)
                target = simpler
                found = write(target)
        if found.replay is not None and not found.replay.agrees and not force:
            units = dataset.units if dataset is not None else {}
            raise SettingsError(f"export of {found.plant} to {target.name}", *_disagreement(found, units))
        if folder.exists():
            shutil.rmtree(folder)
        half.rename(folder)
    finally:
        shutil.rmtree(half, ignore_errors=True)
    return found


def _check_arms(plant: Plant, where: str) -> None:
    """Raise SettingsError where the motion of axes is that of a rigid-body simulation."""
    what = remedy = ""
    if moves_masses(plant.machine):
        what = "force axes that move links with masses, whose motion is that of a rigid-body simulation"
        remedy = "--to mjcf writes masses, payload and friction of an arm."
    elif has_servos(plant):
        what = "servo axes, whose motion is that of a rigid-body simulation with their controllers"
        remedy = (
            "--to mjcf writes them; sysid init --kind response describes servos by their responses, which all targets have."
        )
    if what:
        raise SettingsError(where, what, "other axes", remedy)


def check_folder(folder: Path) -> None:
    """Raise SettingsError where a folder contains something else than an earlier export."""
    if folder.exists() and not folder.is_dir():
        raise SettingsError(f"--out {folder}", "a file", "a folder")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / REPLAY).is_file():
        expected = "a new or empty folder, or that of an earlier export"
        raise SettingsError(f"--out {folder}", "a folder with other files", expected)


def _replayed(plant: Plant, target: Target, folder: Path, dataset: Dataset) -> Replay | None:
    """The replay of written files; None where they cannot run here."""
    simulation = target.simulation(plant, folder)
    if simulation is None:
        return None
    recordings, noise = held_out(dataset), noise_levels(dataset)
    if moves_masses(plant.machine):
        return force_replay(plant, cast("ForceSimulation", simulation), recordings, noise)
    return replay(plant, cast("Simulation", simulation), recordings, noise, target.resolution)


def held_out(dataset: Dataset) -> Sequence[Recording]:
    """Recordings that no fit has used; all motion where the dataset has no roles."""
    return dataset.with_role("held_out") or dataset.of_kind("motion")


def _disagreement(found: Export, units: Mapping[str, str]) -> tuple[str, str, str]:
    assert found.replay is not None
    worst = max((row for row in found.replay.rows if not row.agrees), key=lambda row: row.difference / row.allowed)
    unit = unit_of(worst.signal, units)
    what = f"{worst.signal} differs from the plant by {shown(worst.difference, unit)} RMS, {shown(worst.allowed, unit)} allowed"
    if found.lacking:
        what += f"; not representable: {', '.join(found.lacking)}"
    return what, "an export that agrees with the plant", "--force keeps it with its replay table."
