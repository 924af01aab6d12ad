"""Robot models of others, as packages of the Python package index ship them, read and used as a user would: `make robots`.

    python pipelines/read_robots.py [--only PATTERN] [--steps init,check,log,export] [--workers N] [--work FOLDER] [--again]
    python pipelines/read_robots.py --all --publish           (writes reports/robots/; --all: the other models too)

Every model of robots_corpus/corpus.toml is described by `sysid init --from`. A refusal's remedy is followed to the letter.
What is read is compared with an independent reader (MuJoCo for MJCF, Pinocchio for URDF): tip, gravity torque, mass matrix.
Then a short log of the machine's own nominal simulation is ingested and localised, and every export target is tried.
Each model has a folder in the work folder; a step that has a result there is not repeated, unless ``--again`` is given:
after a change of the code. ``commits`` of the result are those that read the models.

Order of reading of robots_corpus/: corpus, limited, mirror, remedy, outside, reading; peers, check; nominal, exports, steps;
page.
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Any

from committed import commit_of, provenance, write_result
from robots_corpus.corpus import SEED, Robot, fetch, listed, others, packages
from robots_corpus.page import line, page, published, swept, table
from robots_corpus.reading import read
from robots_corpus.steps import check, export, log

ROOT = Path(__file__).resolve().parents[1]
REPORTS = ROOT / "reports" / "robots"
PACKAGES = ("mujoco-core", "pin", "pybullet", "fmpy", "usd-core", "torch")
#: Step → what it adds to the row of a model that was read.
AFTER: Mapping[str, Callable[[Robot, Mapping[str, Any], Path], dict[str, Any]]] = {"check": check, "log": log, "export": export}
STEPS = ("init", *AFTER)


def steps_of(text: str) -> list[str]:
    """Names of steps, separated by commas, in their order.

    Raises:
        ValueError: a step that does not exist.
    """
    unknown = [name for name in text.split(",") if name not in STEPS]
    if unknown:
        raise ValueError(f"--steps: no step {unknown[0]!r}; expected some of {', '.join(STEPS)}")
    return [name for name in STEPS if name in text.split(",")]


def run_robot(robot: Robot, steps: Sequence[str], work: Path, again: bool) -> dict[str, Any]:
    """The row of one model. A step whose result is in its folder is not repeated; after a new ``init`` none of them is kept."""
    folder = work / robot.key
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "row.json"
    row: dict[str, Any] = json.loads(path.read_text("utf-8")) if path.is_file() else {}
    for step in steps:
        if step == "init" and (again or not row):
            row = read(robot, folder) | {"commit": commit_of(ROOT)}
        elif step != "init" and row.get("read") and (again or step not in row) and (step != "export" or _has_log(row)):
            row[step] = AFTER[step](robot, row, folder)
        path.with_suffix(".part").write_text(json.dumps(row, indent=1), "utf-8")
        os.replace(path.with_suffix(".part"), path)
    return row


def _has_log(row: Mapping[str, Any]) -> bool:
    return "log" in row and "broke" not in row["log"]


def run_all(robots: Sequence[Robot], steps: Sequence[str], work: Path, workers: int, again: bool) -> list[dict[str, Any]]:
    """A row for each model, in their order; every step is a process, so that threads suffice."""
    with ThreadPoolExecutor(workers) as pool:
        waiting = [pool.submit(partial(run_robot, robot, steps, work, again)) for robot in robots]
        for number, done in enumerate(as_completed(waiting), 1):
            print(f"{number:4d}/{len(waiting)} {line(done.result())}", flush=True)
        return [done.result() for done in waiting]


def main(given: argparse.Namespace) -> None:
    steps, wanted = steps_of(given.steps), packages()
    if given.publish and given.only:
        raise ValueError("--publish with --only: expected all models in a published result")
    roots = fetch(wanted, given.work)
    chosen = partial(filter, lambda robot: fnmatch.fnmatch(f"{robot.package}/{robot.file}", f"*{given.only}*"))
    rows = run_all(list(chosen(listed(wanted, roots))), steps, given.work / "models", given.workers, given.again)
    command = f"python pipelines/read_robots.py{' --all' if given.all else ''} --publish"
    result = provenance(command, SEED, PACKAGES) | {"packages": {p.name: f"{p.version}, {p.licence}" for p in wanted}}
    if given.all:
        further = list(chosen(others(wanted, roots)))
        result["others"] = swept(run_all(further, ["init", "check"], given.work / "others", given.workers, given.again))
    result |= {"commits": sorted({row["commit"] for row in rows if row.get("commit")}), "models": published(rows)}
    write_result(given.work / "result.json", result)
    print(table(result))
    if given.publish:
        write_result(REPORTS / "result.json", result)
        (REPORTS / "README.md").write_text(page(result), "utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", metavar="PATTERN", help="models whose package/file matches *PATTERN*")
    parser.add_argument("--steps", default=",".join(STEPS), help="separated by commas")
    parser.add_argument("--workers", type=int, default=2, help="models side by side; each process has one thread")
    parser.add_argument("--work", type=Path, default=ROOT / "workspace" / "robots", help="folder of packages and results")
    parser.add_argument("--again", action="store_true", help="repeat steps that have a result")
    parser.add_argument("--all", action="store_true", help="read and check all further models of the packages, and count them")
    parser.add_argument("--publish", action="store_true", help="write reports/robots/")
    try:
        main(parser.parse_args())
    except (ValueError, RuntimeError) as error:
        parser.exit(2, f"{error}\n")
