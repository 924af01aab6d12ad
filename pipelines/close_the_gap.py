"""Closing the loop: a machine that hides five kinds of errors is deployed, identified and deployed again.

.venv/bin/python pipelines/close_the_gap.py [--seeds 0 1 2 3 4] [--excitation] [--work DIR] [--publish]

For every seed a machine of the simulated test bench is drawn and sealed (parts in pipelines/loop/). Inverse kinematics with the
cylinder controller of the nominal plant follows helix and circle on it, over its CAN bus; flight log and motion capture are
ingested, the gap is named, and controller and kinematics of the repaired plant are deployed again, until nothing more is named.
The truth is read after the last round. story.rrd in the folder of a machine shows its first and its last round (Rerun). What
the work folder has of a machine is not run again (rounds.json, compared.json). With ``--excitation`` every round also makes
the recordings that the gap workflow of the round before proposed, and no other controller is run. With ``--publish`` the result
goes to reports/loop/ and the tables to reports/loop/README.md; excitation has its own file and table.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from committed import provenance, write_result, write_tables
from loop.alternatives import LAG_DELAY_GAIN, WITH_DEADBAND, deployed, fixed_structure, guessed_plant, true_plant
from loop.page import rounds_table, summary, tables
from loop.policies import policy_deployment
from loop.rounds import Site, close_gap
from loop.score import machine_result, read_truth
from loop.sealed import draw_machine, write_site, write_truth
from loop.story import write_story
from simulated_bench.recipe import AXES
from sysid.gap.experiment import Planning

ROOT = Path(__file__).resolve().parents[1]
REPORTS = ROOT / "reports" / "loop"
PAGE = REPORTS / "README.md"
PIPELINE = "pipelines/close_the_gap.py"
SEEDS = (0, 1, 2, 3, 4)
#: Plants that have the machine's dead-bands; the others need wide thresholds.
IDENTIFIED = ("repaired", "truth")
#: Plants for which a policy is trained too.
POLICIES = ("nominal", "repaired", "truth")


def main(seeds: tuple[int, ...], work: Path, publish: bool, excitation: bool = False) -> Path:
    """Run the loop on the machine of every seed and write the result."""
    folder = work / "excitation" if excitation else work
    flag = " --excitation" if excitation else ""
    head = provenance(f"{PIPELINE} --seeds {' '.join(map(str, seeds))}{flag}", seeds[0])
    machines = [run_machine(seed, folder / f"machine-{seed}", excitation) for seed in seeds]
    result = {**head, "seeds": list(seeds), "machines": machines}
    report = (REPORTS if publish else folder) / ("excitation.json" if publish and excitation else "result.json")
    write_result(report, result)
    text = rounds_table(machines) if excitation else tables(result)
    if not publish:
        print(text)
        return report
    write_tables(PAGE, text, f"{PIPELINE}{flag}")
    if not excitation:
        write_tables(PAGE, summary(result), f"{PIPELINE}, all controllers")
    return report


def run_machine(seed: int, folder: Path, excitation: bool) -> dict[str, Any]:
    """The entry of one machine: its rounds, and other controllers beside them; what the folder has is not run again."""
    found = kept(folder / "rounds.json", lambda: run_rounds(seed, folder, excitation))
    if excitation:
        return found
    return {**found, "compared": kept(folder / "compared.json", lambda: compare(seed, folder, found))}


def kept(path: Path, make: Callable[[], Mapping[str, Any]]) -> dict[str, Any]:
    """The content of ``path``, which is made if it is missing."""
    if not path.exists():
        write_result(path, make())
    content: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return content


def run_rounds(seed: int, folder: Path, excitation: bool) -> dict[str, Any]:
    """Draw and seal the machine of a seed, close its gap, and compare the names with the truth."""
    shutil.rmtree(folder, ignore_errors=True)
    machine = draw_machine(seed)
    site, truth = Site(machine, folder), folder / "sealed" / "truth.json"
    write_site(machine, site.description)
    write_truth(machine, truth)
    begin = time.perf_counter()
    planning = Planning() if excitation else None
    rounds = close_gap(site, lambda text: print(f"seed {seed}, {text}", flush=True), planning)
    seconds = time.perf_counter() - begin
    print(write_story(folder / "story.rrd", site.nominal().machine, rounds, f"closing the gap, seed {seed}"))
    return {**machine_result(f"seed {seed}", read_truth(truth), rounds), "seconds": seconds}


def compare(seed: int, folder: Path, found: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of the controllers of several plants on the machine of a seed, whose rounds are in ``folder``.

    Inverse kinematics follows the path, and a policy that was trained for the plant. All controllers have the same noise, so
    that they differ by their plants only.
    """
    machine = draw_machine(seed)
    site = Site(machine, folder)
    nominal, first = site.nominal(), site.workspace.dataset(found["rounds"][0]["dataset"])
    parked = {name: machine.visible.axis(name).park for name in AXES}
    hidden = read_truth(folder / "sealed" / "truth.json")
    plants = {
        "nominal": nominal,
        "repaired": site.plant(found["rounds"][-1]["plant"]),
        "guessed": guessed_plant(nominal, np.random.default_rng([29, seed, 1])),
        "lag_delay_gain": fixed_structure(nominal, first, LAG_DELAY_GAIN),
        "with_deadband": fixed_structure(nominal, first, WITH_DEADBAND),
        "truth": true_plant(nominal, hidden, parked),
    }
    registered = {name: site.registered(plant) for name, plant in plants.items()}
    deployments = {name: site.deployment(plant, name in IDENTIFIED) for name, plant in registered.items()}
    made = {name: deployed(site, deployment, name) for name, deployment in deployments.items()}
    for name in POLICIES:
        trained = policy_deployment(site, registered[name], deployments[name])
        made[f"policy_{name}"] = deployed(site, trained, f"policy-{name}")
    return made


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS))
    parser.add_argument("--work", type=Path, default=ROOT / "workspace" / "loop")
    parser.add_argument("--excitation", action="store_true", help="make the recordings that the gap workflow proposes")
    parser.add_argument("--publish", action="store_true", help="write reports/loop/ and the tables of the page")
    given = parser.parse_args()
    print(main(tuple(given.seeds), given.work, given.publish, given.excitation))
