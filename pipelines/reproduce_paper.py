"""The paper's workflow on the simulated test bench: raw logs → networks → policies → helix in simulation → machine.

.venv/bin/python pipelines/reproduce_paper.py [--share 1.0] [--seed 0] [--work DIR] [--best] [--publish]

Manual operation, motion capture and 500 poses of the shipped crane are ingested; the paper's actuator and forward networks are
fitted and validated; policy 1 (with action feedback) and policy 2 (without) are trained and follow the helix in simulation;
policy 1 is deployed on the bench over its CAN bus, on which the gripper sways (parts in pipelines/paper/). Beside it stands the
toolkit's best for every figure that the paper states; ``--best`` measures this alone and keeps the other columns of the
committed result. An interrupted run continues. With ``--publish`` the result and the pictures go to reports/paper/ and the
tables to reports/loop/README.md.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

from committed import provenance, write_result, write_tables
from paper import best, machine, networks, policies
from paper.rows import best_table, table
from sysid.datasets import ingest
from sysid.registry import ModelVersion
from sysid.workspace import Workspace, open_workspace

ROOT = Path(__file__).resolve().parents[1]
AUTOLOG = ROOT / "datasets" / "autolog"
REPORT, PAGE = ROOT / "reports" / "paper", ROOT / "reports" / "loop" / "README.md"
PIPELINE = "pipelines/reproduce_paper.py"


def main(share: float, seed: int, work: Path, only_best: bool, publish: bool) -> Path:
    """Run the workflow and write its result."""
    place = open_workspace(work / "workspace")
    dataset = ingest(AUTOLOG, work / "workspace")
    fitted = networks.fit_linkages(place, dataset) if only_best else networks.fit_networks(place, dataset)
    nominal = place.plant(dataset)
    plant = place.models.register(
        nominal.machine.name, "plant", nominal.to_files(), {"dataset": dataset.reference, **nominal.origin}
    )
    if fitted is None:
        result = json.loads((REPORT / "result.json").read_text("utf-8"))
    else:
        result = whole(place, fitted, plant, share, seed, work, REPORT if publish else work)
    found = best.best_of(place, dataset, AUTOLOG, plant.reference, work / "best", seed)
    result["rows"] = [{**row, **best_columns(found.get(row["quantity"]))} for row in result["rows"]]
    result["best"] = provenance(f"{PIPELINE} --best --seed {seed}", seed, ("torch",))
    report = REPORT if publish else work
    write_result(report / "result.json", result)
    tables = f"{best_table(result['rows'])}\n\n{table(result['rows'])}"
    if publish:
        write_tables(PAGE, tables, PIPELINE)
    else:
        print(tables)
    return report / "result.json"


def best_columns(found: best.Best | None) -> dict[str, Any]:
    """The further columns of a row."""
    if found is None:
        return {"best": None, "command": "", "seconds": None}
    return {"best": found.values, "command": found.command, "seconds": round(found.seconds, 1)}


def whole(
    place: Workspace,
    fitted: networks.PaperNetworks,
    plant: ModelVersion,
    share: float,
    seed: int,
    work: Path,
    report: Path,
) -> dict[str, Any]:
    """The paper's method; pictures go to ``report``."""
    forward = fitted.forward.reference
    chosen = policies.recipes(share, seed)
    trained = {arm: policies.train(place, plant.reference, forward, run, work / "policies") for arm, run in chosen.items()}
    episodes = chosen["feedback"].recipe().learning.episodes
    policy = trained["feedback"].policy
    flown = {
        name: machine.deploy(place, AUTOLOG, work / "flights", plant.reference, forward, version, seed)
        for name, version in (("policy 1", policy), ("ik", "ik"))
    }
    rows = [*networks.rows(fitted), *policies.rows(trained, episodes, seed)]
    rows += [row for name, flights in flown.items() for row in machine.rows(flights, name, seed)]
    report.mkdir(parents=True, exist_ok=True)
    (report / "rewards.svg").write_text(policies.reward_picture(trained), "utf-8")
    (report / "machine-helix.svg").write_text(machine.error_picture(flown["policy 1"]["helix"]), "utf-8")
    command = f"{PIPELINE} --share {share:g} --seed {seed}"
    return {**provenance(command, seed, ("torch",)), "rows": [row.to_json() for row in rows]}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--share", type=float, default=1.0, help="of the episodes of both policies")
    parser.add_argument("--seed", type=int, default=0, help="of the policies and of the runs on the bench")
    parser.add_argument("--work", type=Path, default=ROOT / "workspace" / "paper")
    parser.add_argument("--best", action="store_true", help="measure the last column alone, beside the committed others")
    parser.add_argument("--publish", action="store_true", help="write reports/paper/ and the tables of the page")
    given = parser.parse_args()
    print(main(given.share, given.seed, given.work, given.best, given.publish))
