"""First look: from raw logs to named effects, a report and a moving crane. `make demo` and `sysid demo` run this file.

The logs are those in datasets/autolog: a hydraulic crane of four axes, its valves and draw wires in a ROS 2 bag, motion capture
in a Motive export on another clock. Its simulation (machine.toml) knows most of the machine, but not all. Networks are left out
where torch is not installed, the Rerun recording where rerun-sdk is not.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Literal

import sysid
from sysid.cli.gap_tables import show_gap, show_repair, show_world
from sysid.cli.network_tables import show_errors
from sysid.cli.output import PipelineProgress, Printer, rerun_command, write_json
from sysid.extras import install_command, installed
from sysid.networks import PAPER_MAX, NetworkRecipe
from sysid.validate import ValidationReport
from sysid.view import write_rerun

KINDS: tuple[Literal["actuator", "forward"], ...] = ("actuator", "forward")
AUTOLOG = Path(__file__).resolve().parents[1] / "datasets" / "autolog"


def main(workspace: Path, logs: Path = AUTOLOG, recipe: NetworkRecipe | None = None) -> Path:
    """Run the whole line on ``logs`` and return the path of ``<workspace>/demo/result.json``."""
    recipe = recipe or NetworkRecipe()
    place, out = sysid.open(workspace), Printer()
    folder = place.root.make("demo")
    step = PipelineProgress(out)

    with step("ingest") as progress:
        dataset = sysid.ingest(logs, place, progress=progress)
    networks: list[sysid.FittedNetwork] = []
    if installed("torch"):
        for kind in KINDS:
            with step(f"fit {kind}") as progress:
                networks.append(sysid.fit(kind, dataset, place, recipe=recipe, progress=progress))
    with step("gap") as progress:  # the simulation: machine.toml, its URDF, and the actuator networks as linkages
        found = sysid.find_gap(dataset, workspace=place, progress=progress)
    with step("report"):
        page = sysid.report(dataset, folder / "report.html", place)
    gap, reports = found.result, [network.report for network in networks if network.report is not None]
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
        show_repair(out, gap, dataset, place.gap_folder(dataset), workspace)
    result = {
        "schema": 1,
        "dataset": dataset.reference,
        "models": [network.version for network in networks],
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
