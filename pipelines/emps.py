"""EMPS: the gap of two simulations of a measured ball-screw drive, evaluated by the force at measured motion.

    .venv/bin/python pipelines/emps.py FOLDER_WITH_THE_TWO_MAT_FILES      (datasets/emps/README.md says where they come from)

One simulation is a rigid mass without friction, the other knows the published viscous friction as well. The published least
squares (Janot, Gautier, Brunot 2019) depend on their filter, so the same structures are fitted here under ours too.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.signal import sosfiltfilt

from sysid.cli.gap_tables import show_gap
from sysid.cli.output import PipelineProgress, Printer, write_json
from sysid.datasets import Recording, ingest
from sysid.gap import find_gap
from sysid.machine import Axis, KnownEffect
from sysid.plant import Plant, compile_plant, nominal_plant
from sysid.plant.force import ForceInputs, force_inputs
from sysid.reports import write_report
from sysid.workspace import open_workspace

Array = npt.NDArray[np.float64]
RECIPE = Path(__file__).resolve().parents[1] / "datasets" / "emps" / "recipe.toml"
#: "simple": one value an effect, as in the first published structure; "all": directions may differ.
FORMS: tuple[Literal["simple", "all"], ...] = ("simple", "all")
#: Mass [kg], viscous [N·s/m], Coulomb [N], offset [N].
STRUCTURES = {
    "one value each": ("mass", "viscous", "coulomb", "offset"),
    "by direction": ("mass", "viscous +", "viscous -", "coulomb +", "coulomb -"),
}
#: What is published about each structure, with the relative force errors on the two files.
PUBLISHED: dict[str, dict[str, dict[str, float]]] = {
    "one value each": {
        "parameters": {"mass": 95.109, "viscous": 203.50, "coulomb": 20.394, "offset": -3.165},
        "error": {"identify": 0.0408, "pulses": 0.0598},
    },
    "by direction": {
        "parameters": {"viscous +": 166.7, "viscous -": 240.4, "coulomb +": 20.14, "coulomb -": 20.63},
        "error": {"identify": 0.0311},
    },
}


def main(raw: Path, workspace: Path) -> Path:
    """Run the line on the files in ``raw`` and return the path of ``<workspace>/emps/result.json``."""
    place, out, folder = open_workspace(workspace), Printer(), workspace / "emps"
    folder.mkdir(parents=True, exist_ok=True)
    station = PipelineProgress(out)

    with station("ingest") as progress:
        dataset = ingest(raw, workspace, recipe=RECIPE, progress=progress)
    slide, files = (
        dataset.machine.axis("slide"),
        {"identify": dataset.with_role("fit", "select"), "pulses": dataset.with_role("held_out")},
    )
    rigid = nominal_plant(dataset.machine)
    viscous = rigid.with_effect(KnownEffect("viscous_friction", "slide", {"coefficient": 203.50}))

    runs: dict[str, Any] = {}
    for start, plant in {"rigid": rigid, "viscous only": viscous}.items():
        for forms in FORMS:
            with station(f"gap, {start}, {forms} forms") as progress:
                gap = find_gap(dataset, plant, place.models, add=True, forms=forms, progress=progress)
                place.keep_gap(dataset, gap)
            repaired = place.plant(dataset, gap.plant_after) if gap.plant_after else plant
            errors = {
                when: {name: force_error(p, part, slide) for name, part in files.items()}
                for when, p in (("before", plant), ("after", repaired))
            }
            runs[f"{start}, {forms} forms"] = {"error": errors, "gap": gap.to_json()}
            show_gap(out, gap, dataset)
    with station("report"):
        page = write_report(folder / "report.html", place.report_inputs(dataset))

    fits = {name: least_squares(files, slide, name) for name in STRUCTURES}
    out.block(
        "\nRelative force error |measured - model| / |measured|, filtered as in sysid/plant/force.py (published: their filter)"
    )
    rows = [
        (f"{name}: {when}", named(run["gap"]) if when == "after" else "", *shown(run["error"][when]))
        for name, run in runs.items()
        for when in run["error"]
    ]
    for name in STRUCTURES:
        for who, fit in (("least squares", fits[name]), ("published", PUBLISHED[name])):
            rows.append(
                (f"{who}, {name}", ", ".join(f"{k} {v:.2f}" for k, v in fit["parameters"].items()), *shown(fit["error"]))
            )
    out.table(("simulation", "parameters", "identify", "pulses (unseen)"), rows, right=(2, 3))
    result = {"schema": 1, "dataset": dataset.reference, "runs": runs, "least_squares": fits, "published": PUBLISHED}
    write_json(folder / "result.json", {**result, "seconds": station.seconds, "files": {"report": page}})
    out.block(f"Report   {page}\nFigures  {folder / 'result.json'}")
    return folder / "result.json"


def force_error(plant: Plant, recordings: Sequence[Recording], axis: Axis) -> float:
    """‖measured − model‖ / ‖measured‖ of the filtered force over all recordings."""
    model = compile_plant(plant)
    inputs = [force_inputs(recording, axis) for recording in recordings]
    predicted = np.concatenate([part.model_force(model, model.theta[None], axis.name, everywhere=True)[0] for part in inputs])
    return relative(np.concatenate([part.force for part in inputs]), predicted)


def least_squares(files: Mapping[str, Sequence[Recording]], axis: Axis, structure: str) -> dict[str, dict[str, float]]:
    """A published structure fitted to ``identify`` by ordinary least squares on the same filtered rows, and its errors."""
    tables = {name: [force_inputs(recording, axis) for recording in part] for name, part in files.items()}
    rows = {name: np.concatenate([regressors(part, structure) for part in parts]) for name, parts in tables.items()}
    force = {name: np.concatenate([part.force for part in parts]) for name, parts in tables.items()}
    values = np.linalg.lstsq(rows["identify"], force["identify"], rcond=None)[0]
    return {
        "parameters": dict(zip(STRUCTURES[structure], map(float, values), strict=True)),
        "error": {name: relative(force[name], rows[name] @ values) for name in files},
    }


def regressors(part: ForceInputs, structure: str) -> Array:
    """(m, k): acceleration, then speed and its sign, one value each with an offset or by direction; filtered like the force."""
    v, forward, back = part.speed, part.speed > 0.0, part.speed < 0.0
    if structure == "one value each":
        columns = [part.acceleration, v, np.sign(v), np.ones_like(v)]
    else:
        columns = [part.acceleration, v * forward, v * back, 1.0 * forward, -1.0 * back]
    return np.column_stack([sosfiltfilt(part.low_pass, column)[part.rows] for column in columns])


def relative(measured: Array, predicted: Array) -> float:
    return float(np.linalg.norm(measured - predicted) / np.linalg.norm(measured))


def named(gap: dict[str, Any]) -> str:
    return ", ".join(f"{e['name']} {' / '.join(f'{v:.2f}' for v in e['parameters'].values())}" for e in gap["effects"])


def shown(errors: Mapping[str, float]) -> list[str]:
    return [f"{100.0 * errors[name]:.2f} %" if name in errors else "–" for name in ("identify", "pulses")]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raw", type=Path, help="folder with DATA_EMPS.mat and DATA_EMPS_PULSES.mat")
    parser.add_argument("--workspace", type=Path, default=Path("workspace"))
    given = parser.parse_args()
    main(given.raw, given.workspace)
