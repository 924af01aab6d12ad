"""Writes the nominal plant of a machine for every target, each of which replays the held-out recording in its own simulator.

    python -m robots_corpus.exports WORKSPACE DATASET OUT RESULT.json

Runs in a process of its own. ``RESULT.json`` is written after every target, so that it tells how far an interrupted run came.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from pathlib import Path
from typing import Any

from sysid.datasets.recording import Dataset
from sysid.errors import SysidError
from sysid.export.export import TARGETS, export_plant
from sysid.export.target import Target
from sysid.machine.rigid_body import moves_masses
from sysid.plant import Plant
from sysid.workspace import open_workspace


def targets_for(plant: Plant) -> list[Target]:
    """All targets; those that write arms where forces move masses."""
    return [target for target in TARGETS if target.arms or not moves_masses(plant.machine)]


def exported(plant: Plant, dataset: Dataset, target: Target, folder: Path) -> dict[str, Any]:
    """``outcome``: agrees, not run (its simulator is not installed), refused, or failed with what no user should see."""
    begin = time.process_time()
    try:
        made = export_plant(plant, dataset, target, folder / target.name, samples=10)
    except SysidError as error:
        found = {"outcome": "refused", "reason": str(error)[:400]}
    except Exception as error:  # what a user would see as a traceback
        found = {"outcome": "failed", "reason": f"{type(error).__name__}: {error}"[:400]}
    else:
        found = {"outcome": "not run" if made.replay is None else "agrees"}
        if made.lacking:
            found["lacking"] = ", ".join(made.lacking)
    return found | {"seconds": round(time.process_time() - begin, 2)}


def main(workspace: str, name: str, folder: Path, result: Path) -> None:
    place = open_workspace(workspace)
    dataset = place.dataset(name)
    plant = place.plant(dataset)
    found: dict[str, Any] = {}
    for target in targets_for(plant):
        found[target.name] = exported(plant, dataset, target, folder)
        result.write_text(json.dumps(found, indent=1), "utf-8")
    shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspace")
    parser.add_argument("dataset")
    parser.add_argument("out", type=Path)
    parser.add_argument("result", type=Path)
    given = parser.parse_args()
    main(given.workspace, given.dataset, given.out, given.result)
    print(json.dumps({}))
