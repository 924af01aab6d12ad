"""Files made from a workspace: a plant for another simulator, and the report."""

from __future__ import annotations

import difflib
import os
from pathlib import Path
from typing import TYPE_CHECKING

from sysid.actuators import card_named, card_names, is_card
from sysid.actuators.export import export_card
from sysid.datasets import Dataset
from sysid.errors import SettingsError, StoreError
from sysid.export.export import SAMPLES, SEED, Export, check_folder, export_plant, target_named
from sysid.front.place import Place, dataset_in, shown
from sysid.front.place import open as opened
from sysid.reports import write_report

if TYPE_CHECKING:
    from sysid.progress import Progress
    from sysid.workspace import Workspace


def export(
    plant: str,
    target: str,
    out: str | os.PathLike[str],
    *,
    dataset: Dataset | str | None = None,
    workspace: Place = None,
    samples: int = SAMPLES,
    seed: int = SEED,
    force: bool = False,
    progress: Progress | None = None,
) -> Export:
    """Write a stored plant for another simulator, and keep it only if it replays the held-out recordings as the plant does.

    Args:
        plant: ``name`` or ``name@version``; or a card of an actuator (``actuators/NAME``), which is not replayed.
        target: mjcf, urdf, sdf, isaaclab, newton, fmu, simulink, lut or json.
        out: a new folder, or that of an earlier export.
        dataset: whose held-out recordings are replayed; default: that of the plant.
        workspace: see :func:`sysid.open`.
        samples, seed: draws of the parameters.
        force: keep an export that does not agree with the plant.

    Raises:
        StoreError: no such plant, or no dataset of it.
        SettingsError: no such target, it cannot represent the machine, or it does not agree with the plant.
    """
    with shown(progress, "export") as report:
        chosen, folder = target_named(target), Path(out)
        check_folder(folder)
        if is_card(plant):
            if dataset is not None:
                raise SettingsError("sysid export", f"--dataset {dataset} with a card", "a card alone, which has no recordings")
            return export_card(card_named(plant), chosen, folder, samples=samples, seed=seed)
        place = opened(workspace)
        data = replayed_dataset(place, plant, dataset)
        report(0.1, "writing and replaying")
        return export_plant(place.plant(data, plant), data, chosen, folder, force=force, samples=samples, seed=seed)


def replayed_dataset(workspace: Workspace, plant: str, dataset: Dataset | str | None = None) -> Dataset:
    """The dataset whose held-out recordings an export replays: the given one, else that of the plant.

    Raises:
        StoreError: no such plant or dataset, or a plant without a dataset in its lineage.
    """
    try:
        source = dataset or workspace.models.find(plant).lineage.get("dataset")
    except StoreError as error:
        close = difflib.get_close_matches(plant, card_names(), n=1)
        remedy = f"{error.remedy} Or the card actuators/{close[0]}?".strip() if close else error.remedy
        raise StoreError(error.where, error.found, error.expected, remedy) from None
    if not isinstance(source, str | Dataset):
        raise StoreError(f"model {plant}", "no dataset in its lineage", "--dataset NAME, whose recordings are replayed")
    return dataset_in(workspace, source)


def report(dataset: Dataset | str | None = None, out: str | os.PathLike[str] | None = None, workspace: Place = None) -> Path:
    """Write the HTML report of a dataset, one file that works without a network, and return its path.

    Args:
        dataset: of the workspace, or its reference; None: the only one.
        out: default: ``results/NAME@VERSION/report.html`` in the workspace.
        workspace: see :func:`sysid.open`.

    Raises:
        StoreError: no such dataset.
    """
    place = opened(workspace)
    data = dataset_in(place, dataset)
    inputs = place.report_inputs(data)
    return write_report(Path(out) if out is not None else place.output("report.html", data), inputs)
