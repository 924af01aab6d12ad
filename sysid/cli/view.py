"""``sysid view NAME``: a Rerun recording of the machine; ``sysid report NAME``: the page of a dataset version."""

from __future__ import annotations

from pathlib import Path

import click

from sysid.cli.output import FILE, Printer, command, json_option, long_arrays_beside, rerun_command
from sysid.cli.verbs import viewer


@click.command()
@click.argument("reference", metavar="NAME[@VERSION]|FLIGHT.mcap")
@click.option("--recording", help="Recording; else the first held-out one.")
@click.option("--plant", metavar="PLANT[@VERSION]", help="Simulate with this plant; else before and after.")
@click.option("--out", "path", type=FILE, metavar="FILE.rrd")
@click.option("--live", is_flag=True, help="Simulate the plant in its PyBullet world and show it; with --out into a file.")
@json_option
@click.pass_obj
def view(
    location: str,
    reference: str,
    recording: str | None,
    plant: str | None,
    path: Path | None,
    live: bool,
    out: Printer,
) -> None:
    """Write a Rerun recording: machine, trails and signals, measured and simulated.

    A flight log is shown while the runner writes it, or with --out converted to a file.
    """
    if (show := viewer(Path(reference).suffix)) is not None:
        show(Path(reference), path, out.json_file)
        return
    from sysid.errors import StoreError
    from sysid.view import write_rerun
    from sysid.view.thinning import bucket, stride
    from sysid.workspace import open_workspace

    long_arrays_beside(location)
    workspace = open_workspace(location)
    if recording is None:
        manifest = workspace.datasets.manifest(reference)
        names = [item["name"] for item in manifest["recordings"] if item["kind"] == "motion"]
        shown = [*(name for name in names if manifest["splits"].get(name) == "held_out"), *names]
        if not shown:
            raise StoreError(f"{manifest['name']}@{manifest['version']}", "no recording of motion", "at least one")
        recording = shown[0]
    dataset = workspace.dataset(reference, [recording])
    if live:
        from sysid.view.live import show_live

        moving = workspace.simulation(dataset, plant)
        states = show_live(dataset, recording, moving, path)
        out.line(f"{path or 'viewer'}  ({states} states of {moving.reference or 'the nominal plant'}, {recording})")
        if moving.machine.text != dataset.machine.text:
            out.line(f"{moving.reference} has another machine.toml than {dataset.reference}.")
        out.json({"schema": 1, "file": path, "dataset": dataset.reference, "recording": recording, "states": states})
        return
    predictions = workspace.predictions(dataset, recording, plant)
    path = path or workspace.output(f"{recording.replace('#', '-')}.rrd", dataset)
    result = workspace.gap(dataset) if plant is None else None
    write_rerun(path, dataset, recording, predictions, result)
    out.line(f"{path}  ({recording} of {dataset.reference}; measured, {', '.join(predictions)})")
    samples = len(dataset.recording(recording))
    if bucket(samples) > 1:
        out.line(
            f"{samples} samples: shown are the lowest and the highest of every {bucket(samples)}, around the largest error "
            f"all, and one pose in {stride(samples)}."
        )
    out.line(f"View: {rerun_command(path)}")
    counts = {"samples": samples, "extremes_of": bucket(samples), "poses_every": stride(samples)}
    made_of = {"dataset": dataset.reference, "recording": recording, "simulations": list(predictions)}
    out.json({"schema": 1, "file": path, **made_of, **counts})


@click.command()
@click.argument("reference", metavar="[NAME[@VERSION]]", required=False)
@click.option("--out", "path", type=FILE, metavar="FILE.html")
@json_option
@click.pass_obj
def report(location: str, reference: str | None, path: Path | None, out: Printer) -> None:
    """Write the HTML report of a dataset: one file that works without a network."""
    from sysid.front import files
    from sysid.workspace import open_workspace

    long_arrays_beside(location)
    workspace = open_workspace(location)
    dataset = workspace.dataset(reference)
    path = files.report(dataset, path, workspace)
    gap = workspace.gap(dataset)
    out.line(f"{path}  ({path.stat().st_size / 1e6:.1f} MB)")
    if gap is None:
        out.line(f"The report has no comparison with a simulation yet: {command('gap', dataset.name, workspace=location)}")
    verdict = gap.verdict if gap is not None else None
    out.json({"schema": 1, "file": path, "dataset": dataset.reference, "verdict": verdict})
