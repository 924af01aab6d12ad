"""First look: from raw logs to named effects, a report and a moving crane. `make demo` and `sysid demo` run this file.

The logs are those in datasets/autolog: a hydraulic crane of four axes, its valves and draw wires in a ROS 2 bag, motion capture
in a Motive export on another clock. Its simulation (machine.toml) knows most of the machine, but not all. Networks are left out
where torch is not installed, the Rerun recording where rerun-sdk is not.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from sysid.cli.gap_tables import show_gap, show_repair, show_world
from sysid.cli.network_tables import show_errors
from sysid.cli.output import PipelineProgress, Printer, rerun_command, write_json
from sysid.datasets import ingest
from sysid.extras import install_command, installed
from sysid.gap import find_gap
from sysid.networks import PAPER_MAX, Model, NetworkRecipe, fit_actuator, fit_forward
from sysid.reports import write_report
from sysid.validate import ValidationReport, validate_model
from sysid.view import write_rerun
from sysid.workspace import open_workspace

AUTOLOG = Path(__file__).resolve().parents[1] / "datasets" / "autolog"


def main(workspace: Path, logs: Path = AUTOLOG, recipe: NetworkRecipe | None = None) -> Path:
    """Run the whole line on ``logs`` and return the path of ``<workspace>/demo/result.json``."""
    recipe = recipe or NetworkRecipe()  # the paper's
    place, out = open_workspace(workspace), Printer()
    folder = place.root.make("demo")
    step = PipelineProgress(out)

    with step("ingest") as progress:
        dataset = ingest(logs, workspace, progress=progress)
    networks: list[Model] = []
    if installed("torch"):
        with step("fit actuator") as progress:
            networks.append(fit_actuator(dataset, recipe, progress))
        with step("fit forward") as progress:
            networks.append(fit_forward(dataset, recipe, progress))
    with step("validate"):
        reports = [validate_model(network, dataset, recipe=recipe) for network in networks]
        versions = [place.add_network(dataset, n, recipe, report) for n, report in zip(networks, reports, strict=True)]
    with step("simulate"):
        plant = place.plant(dataset)  # machine.toml, its URDF, and the actuator networks as linkages
    with step("gap") as progress:
        gap = find_gap(dataset, plant, place.models, add=True, progress=progress)
        kept = place.keep_gap(dataset, gap).parent
    with step("report"):
        page = write_report(folder / "report.html", place.report_inputs(dataset))
    film = None
    if installed("rerun"):
        with step("view"):
            recording = gap.held_out_recordings[0]
            simulated = place.predictions(dataset, recording)
            film = write_rerun(folder / f"{recording}.rrd", dataset, recording, simulated, gap)

    out.block(f"\nDataset {dataset.reference}: {len(dataset.recordings)} recordings from {len(dataset.sources)} files\n")
    if reports:
        show_errors(out, *reports, paper=PAPER_MAX)
    show_gap(out, gap, dataset)
    show_world(out, gap, dataset)
    if gap.plant_after:
        show_repair(out, gap, dataset, kept, workspace)
    result = {
        "schema": 1,
        "dataset": dataset.reference,
        "models": [version.reference for version in versions],
        "networks": network_errors(reports),
        "gap": gap.to_json(),
        "seconds": step.seconds,
        "files": {"report": page, "rerun": film},
    }
    write_json(folder / "result.json", result)
    view = f"{film}   (view: {rerun_command(film)})" if film is not None else f"left out: {install_command('rerun')}"
    out.block(f"\nReport   {page}\nRerun    {view}\nFigures  {folder / 'result.json'}")
    if not networks:
        out.line(f"Networks were left out: {install_command('torch')}")
    return folder / "result.json"


def network_errors(reports: list[ValidationReport]) -> dict[str, Any]:
    """Output → kind of rows → errors in SI units; for the boom tip the paper's maximum beside them."""
    errors: dict[str, Any] = {}
    for entry in (entry for report in reports for entry in report.outputs):
        figures = {key: getattr(entry.metrics, key) for key in ("rmse", "p95", "max")}
        place = errors.setdefault(entry.output, {"unit": entry.unit})
        place[entry.rows] = {**figures, "noise_floor": entry.noise_floor}
        if entry.output in PAPER_MAX:
            place["paper_max"] = PAPER_MAX[entry.output]
    return errors


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workspace", type=Path, default=Path("workspace"))
    main(parser.parse_args().workspace)
