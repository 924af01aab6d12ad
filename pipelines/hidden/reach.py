"""Errors of the true plant on the held-out recordings of a case: the lower limit of what a repair can reach."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from sysid.datasets import ingest
from sysid.gap.disagreement import run_rmse, stage_gap
from sysid.gap.prepare.case import open_case
from sysid.machine import KnownEffect
from sysid.plant import Plant, compile_plant, free_run, nominal_plant


def reach(site: Path, sealed: Path, out: Path) -> None:
    """Write the RMSE by signal of the owner's plant with the true effects: free runs, and forces at measured motion."""
    effects = json.loads(sealed.read_text("utf-8"))["effects"]
    with tempfile.TemporaryDirectory() as workspace:
        dataset = ingest(site, workspace)
        plant = nominal_plant(dataset.machine)
        for effect in effects:
            plant = with_truth(plant, effect)
        model = compile_plant(plant)
        held_out = [r for r in dataset.recordings if dataset.splits[r.name] == "held_out" and r.kind == "motion"]
        scores = run_rmse([(r, free_run(model, r)) for r in held_out])
        if any(axis.actuation == "force" for axis in dataset.machine.axes):
            case, stages = open_case(dataset, plant, 0)
            driven = stage_gap(case, stages, case.theta).before
            scores |= {signal: driven[signal] for signal in driven if signal.endswith(".command")}
    out.write_text(json.dumps(scores) + "\n", "utf-8")


def with_truth(plant: Plant, effect: dict[str, Any]) -> Plant:
    """The plant with one sealed effect; backlash is on the drive's side of its sensor, unless the truth states another side."""
    side = effect.get("side", "drive" if effect["name"] in ("backlash", "joint_compliance") else None)
    return plant.with_effect(KnownEffect(effect["name"], effect["target"], effect["parameters"], side))  # type: ignore[arg-type]
