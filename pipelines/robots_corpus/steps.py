"""The steps after a model was read, each in processes of its own: check, log, export."""

from __future__ import annotations

import json
import math
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from robots_corpus.corpus import Robot
from robots_corpus.limited import Done, Limits, run
from robots_corpus.peers import unnoted

PIPELINES = Path(__file__).resolve().parents[1]
#: Name of the machine of every model.
NAME = "r"
#: Processor time and wall time of a step [s].
CHECK, LOG, INGEST, GAP, EXPORT = (
    Limits(60, 120.0),
    Limits(120, 240.0),
    Limits(120, 240.0),
    Limits(300, 600.0),
    Limits(240, 480.0),
)
#: Largest differences that count as equal: of the tip [m]; of torque and mass matrix, relative to the largest entry.
SAME = {"tip_m": 1e-9, "torque": 1e-6, "mass_matrix": 1e-6}


def part(module: str, arguments: Sequence[object], limits: Limits) -> dict[str, Any]:
    """The object that a module of this folder prints; ``broke`` where it prints none."""
    command = [sys.executable, "-m", f"robots_corpus.{module}", *map(str, arguments)]
    done = run(command, limits, env={"PYTHONPATH": str(PIPELINES)})
    if done.code == 0 and not done.broke:
        found: dict[str, Any] = json.loads(done.text.strip().splitlines()[-1])
        return found | {"seconds": done.seconds}
    return {"broke": _what_broke(done), "seconds": done.seconds}


def _what_broke(done: Done) -> str:
    return done.broke or " ".join(done.text.split())[-400:] or f"exit {done.code}"


def machine_file(folder: Path) -> Path:
    return folder / "site" / "datasets" / NAME / "machine.toml"


def check(robot: Robot, row: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The comparison with the independent reader; ``wrong``: what differs without a note."""
    found = part("check", [machine_file(folder), folder / row["model"] if row["model"] else robot.path], CHECK)
    wrong = [f"{key} {found[key]:.2g}" for key in SAME if key in found and not found[key] <= SAME[key]]
    wrong += [f"no note on {what}" for what in unnoted(found.get("differs", []), row["notes"])]
    return found | {"wrong": wrong}


def log(robot: Robot, row: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Recordings of the nominal simulation, ingested and localised; ``above``: largest error over its noise floor."""
    workspace, dataset = folder / "workspace", machine_file(folder).parent
    for old in (workspace, dataset / "logs"):
        shutil.rmtree(old, ignore_errors=True)
    made = part("nominal", [machine_file(folder), dataset / "logs"], LOG)
    if "broke" in made:
        return {"broke": f"nominal simulation: {made['broke']}", "seconds": made["seconds"]}
    sysid, out = [sys.executable, "-m", "sysid.cli", "--workspace", str(workspace)], folder / "gap.json"
    ingest = run([*sysid, "ingest", str(dataset)], INGEST)
    if ingest.code != 0:
        return {"broke": f"ingest: {_what_broke(ingest)}", "seconds": made["seconds"] + ingest.seconds}
    gap = run([*sysid, "gap", NAME, "--localise", "--json", str(out)], GAP)
    seconds = {"nominal": made["seconds"], "ingest": ingest.seconds, "gap": gap.seconds}
    if gap.code != 0:
        return {"broke": f"gap: {_what_broke(gap)}", "seconds": sum(seconds.values())}
    found = json.loads(out.read_text("utf-8"))
    return {"verdict": found["verdict"], "above": above(found["localised"]), "seconds": round(sum(seconds.values()), 2)}


def above(localised: Sequence[Mapping[str, Any]]) -> float | None:
    """Largest error of a free run over its noise floor; of a stage where a signal has no free run."""
    ratios = []
    for item in localised:
        error = item["free_run_rmse"] if _is_number(item["free_run_rmse"]) else item["stage_rmse"]
        if _is_number(error) and item["noise_floor"]:
            ratios.append(error / item["noise_floor"])
    return round(max(ratios), 3) if ratios else None


def _is_number(value: Any) -> bool:
    return isinstance(value, float) and math.isfinite(value)


def export(robot: Robot, row: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Target → what became of the export."""
    result = folder / "exports.json"
    result.unlink(missing_ok=True)
    done = part("exports", [folder / "workspace", NAME, folder / "out", result], EXPORT)
    found = {"targets": json.loads(result.read_text("utf-8")) if result.is_file() else {}, "seconds": done["seconds"]}
    return found | ({"broke": done["broke"]} if "broke" in done else {})
