"""Effect of feedback, hindsight and other choices of training: policies evaluated on one helix.

.venv/bin/python pipelines/training.py [--tier small|full] [--workers N] [--workspace DIR] [--minutes N]

Needs the versions of `make demo`. An interrupted run continues, on another computer from the committed result. ``full`` takes
about six hours of a core; with ``--minutes`` no training begins after that time, and the results so far are written. Result,
tables and reward curves go to reports/training/. ``small`` tests that everything runs, with
its files in the workspace.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

from committed import provenance, write_result, write_tables
from sysid.cores import cores
from sysid.execution import LocalExecutor
from sysid.files import plain
from trained.page import by_arm, curves, tables
from trained.peer import peer
from trained.policies import baselines, kept, one
from trained.runs import ROOT, Run, runs

REPORT = ROOT / "reports" / "training"
PAGE = REPORT / "README.md"
#: Share of the episodes and seeds by part.
TIERS: dict[str, tuple[float, dict[str, int]]] = {
    "small": (0.02, {"policies": 1, "whole": 1, "driven": 1, "choices": 1, "candidates": 1, "peer": 1}),
    "full": (1.0, {"policies": 5, "whole": 1, "driven": 3, "choices": 3, "candidates": 3, "peer": 3}),
}
#: SB3 gets so many times the processor time of a whole quick policy.
PATIENCE = 5.0
#: The policies that are trained before SB3's; the others are trained after them.
FIRST = ("quick", "paper")


def main(tier: str, workspace: Path, workers: int | None, minutes: float = math.inf) -> Path:
    """Train what is not there yet and write the result."""
    until = time.time() + 60.0 * minutes
    share, seeds = TIERS[tier]
    work = workspace / "training_study" / tier
    work.mkdir(parents=True, exist_ok=True)
    todo = list(runs(share, seeds))
    if tier == "full":
        put_back(REPORT / "result.json", todo, work)
    done: list[dict[str, Any]] = []

    def train(those: Sequence[Run]) -> None:
        found = _all(one, [(str(workspace), str(work), run, until) for run in those], workers)
        done.extend(result for result in found if result is not None)

    train([run for run in todo if run.part in FIRST])
    quick = by_arm(done)["quick", "feedback"]
    if not quick:
        raise SystemExit(f"no policy of quick.toml was done in {minutes:g} minutes; give it more, the next start goes on")
    limit = PATIENCE * statistics.median(result["cpu_seconds"] for result in quick)
    peers = _all(peer, [(str(workspace), str(work), seed, limit, until) for seed in range(seeds["peer"])], workers)
    theirs = [each for each in peers if each is not None]
    train([run for run in todo if run.part not in FIRST])
    head = provenance(f"pipelines/training.py --tier {tier}", 0, ("torch", "stable-baselines3"))
    whole = head | {"listed": len(todo), "baselines": baselines(str(workspace)), "runs": done, "stable_baselines3": theirs}
    report, text = REPORT if tier == "full" else work, tables(whole)
    write_result(report / "result.json", whole)
    (report / "tables.md").write_text(text + "\n", "utf-8")
    (report / "curves.svg").write_text(curves(whole), "utf-8")
    if tier == "full":
        write_tables(PAGE, text, "pipelines/training.py")
    return report


def put_back(result: Path, todo: Sequence[Run], work: Path) -> None:
    """Copy the runs of a committed result to ``work``, so that they are not trained again."""
    if not result.exists():
        return
    known = json.loads(result.read_text("utf-8"))
    wanted = {run.name: plain(asdict(run)) for run in todo}
    for each in known["runs"]:
        name = Run(**each["run"]).name
        if wanted.get(name) == each["run"]:
            kept(work / f"{name}.json", {"run": each["run"]}, math.inf, partial(dict, each))
    for each in known["stable_baselines3"]:
        kept(work / f"sb3-seed{each['seed']}.json", {"seed": each["seed"]}, math.inf, partial(dict, each))


def _all(
    work: Callable[..., dict[str, Any] | None], calls: Sequence[tuple[Any, ...]], workers: int | None
) -> list[dict[str, Any] | None]:
    last = [0.0]

    def tell(share: float, text: str) -> None:
        if share - last[0] >= 0.01:
            last[0] = share
            print(f"{100.0 * share:4.0f} %  {text}", flush=True)

    return LocalExecutor(workers or cores()).run(work, calls, tell, reports=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tier", choices=TIERS, default="small")
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--workspace", type=Path, default=ROOT / "workspace")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin nothing new after so many")
    given = parser.parse_args()
    print(main(given.tier, given.workspace, given.workers, given.minutes))
