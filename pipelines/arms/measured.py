"""Figures of the other pipelines on measured machines, which a change must not make worse. All are errors: less is better."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.model_selection import RepeatedKFold

from measured import poses
from sysid.machine import load_machine

#: Relative change of a figure that counts as none: repeated runs differ by rounding only, other computers by less than this.
SAME = 0.01


def figures(workspace: Path, data: Path) -> dict[str, float]:
    """Name → figure, from ``<workspace>/<pipeline>/result.json`` where it is there, and pose sets calibrated anew.

    Args:
        data: folder with ``tiago_mocap``; without it no pose set is calibrated.
    """
    found: dict[str, float] = {}
    for name, read in (("emps", _emps), ("xl330", _xl330), ("so101", _so101), ("ur10e", _ur10e)):
        path = workspace / name / "result.json"
        if path.exists():
            found |= read(json.loads(path.read_text("utf-8")))
    for arm in poses.ARMS if (data / "tiago_mocap").is_dir() else ():
        found |= calibrated(arm, data / "tiago_mocap")
    return found


#: Pipeline → entry of its result that has the runs, and key of the gap of a run; None: the run is a gap.
GAPS = {"emps": ("runs", "gap"), "xl330": ("views", "together"), "so101": ("runs", None), "ur10e": ("runs", None)}


def names(workspace: Path) -> dict[str, list[str]]:
    """Run → named effects, ``effect(target)``."""
    found: dict[str, list[str]] = {}
    for pipeline, (runs, key) in GAPS.items():
        path = workspace / pipeline / "result.json"
        if path.exists():
            for run, each in json.loads(path.read_text("utf-8"))[runs].items():
                effects = (each if key is None else each[key])["effects"]
                found[f"{pipeline}, {run}"] = [f"{effect['name']}({effect['target']})" for effect in effects]
    return found


def _emps(result: Mapping[str, Any]) -> dict[str, float]:
    """Relative force errors on the held-out file."""
    return {f"EMPS, {name}, pulses [relative]": run["error"]["after"]["pulses"] for name, run in result["runs"].items()}


def _xl330(result: Mapping[str, Any]) -> dict[str, float]:
    """Held-out errors of all logs together."""
    return {
        f"XL330, {view}, {signal} [SI]": value
        for view, each in result["views"].items()
        for signal, value in each["together"]["gap"]["after"].items()
    }


def _so101(result: Mapping[str, Any]) -> dict[str, float]:
    return {
        f"SO-101, {recording}, {signal} [mrad]": 1e3 * value
        for recording, run in result["runs"].items()
        for signal, value in run["gap"]["after"].items()
    }


def _ur10e(result: Mapping[str, Any]) -> dict[str, float]:
    """Relative torque errors on held-out recordings, and the error of the payload's mass from each log that names it."""
    found = {
        f"UR10e, {log}, {signal} [relative]": value for log, each in result["left"].items() for signal, value in each.items()
    }
    published = result["published"]["payload"]
    masses = {log: mass for log, mass in result["payload"].items() if mass is not None}
    return found | {
        f"UR10e, {log}, mass of the payload [relative]": abs(mass / published - 1.0) for log, mass in masses.items()
    }


def merged_machines(earlier: Mapping[str, Any], fresh: Mapping[str, Any]) -> dict[str, Any]:
    """``fresh`` figures and names beside those of ``earlier`` whose machine it does not have."""
    found: dict[str, Any] = {}
    for key in ("figures", "named"):
        own = {text.partition(",")[0] for text in fresh[key]}
        found[key] = {text: value for text, value in earlier.get(key, {}).items() if text.partition(",")[0] not in own}
        found[key] |= fresh[key]
    return found


def calibrated(arm: poses.Arm, folder: Path) -> dict[str, float]:
    """Cross-validated distance of the calibrated geometry [mm], median and RMSE."""
    machine = load_machine(poses.DATASETS / arm.name / "machine.toml")
    q, tip = poses.read(arm, machine, folder)
    errors: dict[str, list[Any]] = {}
    for fit, held in RepeatedKFold(n_splits=poses.FOLDS, n_repeats=poses.REPEATS, random_state=0).split(q):
        for name, predict in poses.geometric(machine, q[fit], tip[fit]).items():
            errors.setdefault(name, []).append(np.linalg.norm(predict(q[held]) - tip[held], axis=1))
    found = {}
    for name, parts in errors.items():
        distance = 1e3 * np.concatenate(parts)
        found[f"{arm.title}, {name}, median [mm]"] = float(np.median(distance))
        found[f"{arm.title}, {name}, RMSE [mm]"] = float(np.sqrt(np.mean(distance**2)))
    return found


def compared(before: Mapping[str, float], after: Mapping[str, float]) -> list[tuple[str, str, str, str]]:
    """Rows of a table: figure, before, after, and whether it is the same, better or worse."""
    rows = []
    for name, value in before.items():
        new = after.get(name)
        change = (
            "–"
            if new is None
            else "worse"
            if new > (1.0 + SAME) * value
            else "better"
            if new < (1.0 - SAME) * value
            else "same"
        )
        rows.append((name, f"{value:.4g}", "–" if new is None else f"{new:.4g}", change))
    return rows + [(name, "–", f"{value:.4g}", "new") for name, value in after.items() if name not in before]
