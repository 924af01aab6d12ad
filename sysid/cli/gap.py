"""``sysid gap NAME``: names the missing effects, with ``--simulator`` those of a user's simulator or MuJoCo model."""

from __future__ import annotations

import importlib.util
import inspect
import sys
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sysid.cli.gap_tables import show_gap, show_localised, show_missing, show_repair, show_responses, show_world
from sysid.cli.output import (
    FILE,
    FOLDER,
    Printer,
    cluster_option,
    command,
    json_option,
    progress_bar,
    workers_option,
)
from sysid.errors import InputError, SettingsError, nearest

if TYPE_CHECKING:
    from sysid.actuators import ActuatorCard
    from sysid.datasets.recording import Dataset
    from sysid.gap import Simulator
    from sysid.gap.adapters.adapter import SimulatorAdapter
    from sysid.gap.result import GapResult
    from sysid.gap.stage_search import Forms
    from sysid.plant import Plant

#: Prefix of an MJCF.
MUJOCO = "mujoco:"


def open_simulator(
    place: str, dataset: Dataset, assets: tuple[Path, ...] = (), tell: Callable[[str], object] = print
) -> Simulator | Plant:
    """The simulator of a Python file or of an MJCF, for a dataset.

    Of an MJCF, that of :func:`sysid.gap.adapters.mujoco.open_model`.

    Args:
        assets: further folders below which an MJCF may open files.
        tell: takes the reason for which a model of servos is run itself.

    Raises:
        SettingsError: neither ``FILE.py:NAME`` nor ``mujoco:FILE.xml``, or a model that does not fit the machine.
        InputError: no such file, an error in it, or no simulator.
    """
    if not place.startswith(MUJOCO):
        return load_simulator(place)
    from sysid.gap.adapters.mujoco import open_model

    return open_model(Path(place.removeprefix(MUJOCO)), dataset, assets, tell)


def load_simulator(place: str) -> Simulator:
    """The object ``NAME`` of a Python file; a class is instantiated without arguments.

    The file's folder is searched for the modules that it imports.

    Raises:
        SettingsError: not ``FILE.py:NAME``.
        InputError: no such file, an error in it, or NAME is no simulator.
    """
    from sysid.gap import Simulator

    file, _, name = place.rpartition(":")
    path = Path(file)
    if path.suffix != ".py" or not name.isidentifier():
        expected = "FILE.py:NAME, as in crane.py:Crane, or mujoco:FILE.xml"
        raise SettingsError(f"--simulator {place}", "not a file and a name in it", expected)
    if not path.is_file():
        raise InputError(f"--simulator {path}", "no such file", "a Python file")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise InputError(f"--simulator {path}", "cannot be imported", "a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(path.resolve().parent))
    try:
        spec.loader.exec_module(module)
        if not hasattr(module, name):
            names = [n for n, value in vars(module).items() if hasattr(value, "simulate")]
            raise InputError(f"--simulator {path}", f"no {name!r} in it", nearest(name, names))
        found = getattr(module, name)
        simulator = found() if inspect.isclass(found) else found
    except InputError:
        raise
    except Exception as error:  # whatever a user's file may raise
        raise InputError(f"--simulator {path}", f"{type(error).__name__}: {error}", "a file that runs") from error
    finally:
        sys.path.remove(str(path.resolve().parent))
    if not isinstance(simulator, Simulator):
        found_text, expected = f"{name} has no method simulate", "simulate(recording) → DataFrame"
        raise InputError(f"--simulator {place}", found_text, expected, "See sysid.gap.Simulator.")
    return simulator


def repaired_path(model: Path) -> Path:
    """Where ``--add`` writes the repaired model of an MJCF."""
    return model.with_suffix(f".repaired{model.suffix}")


def write_model(
    out: Printer,
    tested: SimulatorAdapter | Plant,
    result: GapResult,
    dataset: Dataset,
    model: Path,
    path: Path,
    assets: tuple[Path, ...] = (),
) -> dict[str, Any]:
    """Write the repaired model, and return what the JSON says about it.

    Raises:
        InputError: the written model does not do what the repaired simulation does.
    """
    from sysid.gap.adapters.mujoco import write_model
    from sysid.plant.plant import effect_key

    repaired = write_model(model, tested, result, path, dataset, assets)
    out.line(f"Repaired model: {repaired.path}")
    for change in repaired.native:
        out.line(f"    {change.effect.name} of {change.effect.target}: {change.where}")
    for item in repaired.beside:
        why = repaired.reasons.get(effect_key(item), "")
        kept = repaired.side_path is not None and not why
        where = f"{repaired.side_path}, which MJCF cannot express" if kept else "not written"
        out.line(f"    {item.name} of {item.target}: {where}{f' ({why})' if why else ''}")
    if repaired.fitted:
        out.line(f"    fitted once more in MuJoCo, within their intervals: {repaired.fitted}")
    for signal, value in repaired.gap.after.items():
        before, floor = repaired.gap.before[signal], repaired.gap.noise_floor[signal]
        out.line(
            f"    {signal}: error {value:.3g}, loaded again, on held-out recordings (before {before:.3g}, floor {floor:.3g})"
        )
    return {
        "path": str(repaired.path),
        "side_file": str(repaired.side_path) if repaired.side_path is not None else None,
        "native": [{"name": c.effect.name, "target": c.effect.target, "where": c.where} for c in repaired.native],
        "beside": [
            {"name": item.name, "target": item.target, "why": repaired.reasons.get(effect_key(item), "")}
            for item in repaired.beside
        ],
        "fitted": repaired.fitted,
        "gap": {"before": dict(repaired.gap.before), "after": dict(repaired.gap.after)},
    }


def show_card(out: Printer, card: ActuatorCard, result: GapResult) -> dict[str, Any]:
    """The values of a result beside those of a card; returns them as values for JSON."""
    from sysid.actuators.words import compared, comparison_table

    rows = list(compared(card, result.written))
    out.show(comparison_table(card, rows))
    return {"name": card.name, "values": [{**asdict(row), "ratio": row.ratio} for row in rows]}


@click.command()
@click.argument("reference", metavar="NAME[@VERSION]")
@click.option("--plant", metavar="PLANT[@VERSION]", help="The simulation to test; else the nominal one.")
@click.option(
    "--simulator",
    metavar="FILE.py:NAME|mujoco:FILE.xml",
    help="Test a simulator of your own: an object with simulate(recording), or its class; or a MuJoCo model.",
)
@click.option(
    "--assets",
    multiple=True,
    metavar="DIR",
    type=FOLDER,
    help="With --simulator mujoco:FILE.xml: a folder outside of the model's below which it may open files; may be repeated.",
)
@click.option(
    "--out",
    "out_file",
    metavar="FILE.xml",
    type=FILE,
    help="With --simulator mujoco:FILE.xml: write the repaired model here. --add: beside the model, as FILE.repaired.xml.",
)
@click.option("--localise", is_flag=True, help="Only locate the gap.")
@click.option(
    "--add", is_flag=True, help="Store the repaired simulation as a new plant version; promote it if the proof is good enough."
)
@click.option("--world/--no-world", default=None, help="Run the proof also in the PyBullet world. Default: only with --add.")
@click.option(
    "--carry", is_flag=True, help="Fit a bounded residual network to unnamed errors, where it lowers held-out errors."
)
@click.option(
    "--forms",
    type=click.Choice(["all", "simple"]),
    default="all",
    help="simple: every effect in its simplest form only (one friction for both directions).",
)
@click.option(
    "--accept",
    multiple=True,
    metavar="KEY",
    help="Continue although this is implausible: the key of a severe finding, or a glob such as 'boom.*'; may be repeated.",
)
@click.option("--card", metavar="NAME", help="Compare with the card of an actuator: sysid actuators.")
@workers_option
@cluster_option()
@click.option("--verbose", is_flag=True, help="Every near miss and next step, at full length.")
@json_option
@click.pass_obj
def gap(
    location: str,
    reference: str,
    plant: str | None,
    simulator: str | None,
    assets: tuple[Path, ...],
    out_file: Path | None,
    localise: bool,
    add: bool,
    world: bool | None,
    carry: bool,
    forms: Forms,
    accept: tuple[str, ...],
    card: str | None,
    workers: int,
    cluster: str | None,
    trusted_network: bool,
    verbose: bool,
    out: Printer,
) -> None:
    """Name the effects that the simulation lacks, and evaluate them on held-out recordings."""
    from sysid.cli.dataset_tables import show_checked
    from sysid.datasets import Store
    from sysid.datasets.checks.roles import check_needs
    from sysid.execution import open_executor

    if simulator is not None and plant is not None:
        raise SettingsError("sysid gap", "--plant and --simulator", "one of them")
    if localise and carry:
        remedy = "A residual network is fitted to the error that the search leaves."
        raise SettingsError("sysid gap", "--localise and --carry", "one of them", remedy)
    mjcf = None if simulator is None or not simulator.startswith(MUJOCO) else Path(simulator.removeprefix(MUJOCO))
    if assets and mjcf is None:
        raise SettingsError("sysid gap", "--assets without a MuJoCo model", "--simulator mujoco:FILE.xml")
    if out_file is not None and mjcf is None:
        raise SettingsError("sysid gap", "--out without a MuJoCo model", "--simulator mujoco:FILE.xml")
    if mjcf is not None and add and out_file is None:
        out_file = repaired_path(mjcf)
    known = None
    if card is not None:
        from sysid.actuators import card_named

        known = card_named(card)
    data = Store(location).load(reference)
    check_needs(data)  # before anything is compiled
    with progress_bar("gap") as progress:
        progress(0.0, "loading")  # the numerical libraries, which takes seconds
        from sysid.front.gap import find_gap
        from sysid.gap import SimulatorAdapter
        from sysid.plant import Plant
        from sysid.reports import write_report

    found = find_gap(
        data,
        partial(open_simulator, simulator, assets=assets, tell=out.line) if simulator is not None else plant,
        location,
        add=add and mjcf is None,
        world=world,
        localise=localise,
        carry=carry,
        forms=forms,
        accept=accept,
        on_findings=partial(show_checked, out),
        executor=open_executor(cluster, workers, trusted_network=trusted_network),
    )
    result, dataset, workspace, tested = found.result, found.dataset, found.workspace, found.tested
    folder = None if localise else workspace.gap_folder(dataset)
    if isinstance(tested, Plant) and plant is not None and "@" not in plant:
        out.line(f"`{plant}` means {tested.reference}.")
    linked = tested.linkages if isinstance(tested, Plant) else dataset.machine.axis_names
    written = result.to_json(folder)
    for axis in dataset.machine.axes:
        if axis.drives == "cylinder" and axis.name not in linked and f"{axis.name}.joint" in dataset.units:
            fit = command("fit", "actuator", dataset.name, workspace=location)
            out.line(f"{axis.name}: no linkage, so its joint is not simulated; {fit} fits one.")
    if localise:
        show_responses(out, dataset)
        show_localised(out, result, dataset)
        show_missing(out, result)
    else:
        show_gap(out, result, dataset, verbose)
        show_missing(out, result)
        show_world(out, result, dataset)
        if result.experiments:
            out.line()
            out.line("Planned recordings:")
        for planned, experiment in zip(written["experiments"], result.experiments, strict=True):
            out.entry(f"{experiment.name}: {experiment.words}", "  ")
            out.line(f"    {planned['file']}")
        if result.plant_after:
            show_repair(out, result, dataset, folder, location)
        elif not isinstance(tested, Plant):
            for note in result.notes:
                out.line(f"note: {note}")
        elif mjcf is not None:
            if result.repaired and out_file is None:
                out.line("The repair is not written: --out FILE.xml writes it into a copy of the model.")
        elif result.repaired and not add:
            out.line(
                "The repair is not stored: --add stores it as a new plant version, and promotes it if the proof is good enough."
            )
        out.line(f"Report: {command('report', dataset.reference, workspace=location)}")
    if known is not None:
        written["card"] = show_card(out, known, result)
    try:  # the answer is written whatever happens to the files beside it
        if localise:
            page = write_report(workspace.output("localise.html", dataset), workspace.report_inputs(dataset, result))
            out.line(f"With the maps: {page}")
        elif mjcf is not None and isinstance(tested, SimulatorAdapter | Plant) and out_file is not None:
            written["model"] = write_model(out, tested, result, dataset, mjcf, out_file, assets)
    finally:
        out.json(written)
    if result.missing:
        raise SystemExit(1)
