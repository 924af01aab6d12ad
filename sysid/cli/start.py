"""``sysid start FOLDER``: from a folder of logs to a verdict."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from sysid.cli.ingest_inspect import log_files
from sysid.cli.init import KINDS
from sysid.cli.output import Printer, command, json_option, progress_bar, write_json
from sysid.errors import SettingsError
from sysid.numbers import Positive, number
from sysid.root import Root

if TYPE_CHECKING:
    from sysid.datasets.drafting import Description
    from sysid.machine import Machine


@click.command()
@click.argument("folder", metavar="FOLDER", type=click.Path(file_okay=False, path_type=Path))
@click.option("--name", default=None, help="Name of the machine and of its dataset; the folder's name if left out.")
@click.option(
    "--robot",
    default=None,
    metavar="FILE",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The machine's URDF or MJCF: axes, limits, masses.",
)
@click.option(
    "--kind",
    type=click.Choice(KINDS),
    default=None,
    help="What the commands are: speeds (hydraulic), positions (servo) or forces (force); as the data show if left out.",
)
@click.option(
    "--set",
    "answers",
    multiple=True,
    metavar="KEY=VALUE",
    help="The answer to a question that start has asked; may be repeated.",
)
@click.option("--reader", default=None, help="Read all files as this format, where their suffix does not say which (json).")
@click.option("--yes", is_flag=True, help="Take the proposal of every question.")
@click.option(
    "--out",
    "out_folder",
    default=None,
    metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder of machine.toml and recipe.toml; beside the logs if left out.",
)
@json_option
@click.pass_context
def start(
    context: click.Context,
    folder: Path,
    name: str | None,
    robot: Path | None,
    kind: str | None,
    answers: tuple[str, ...],
    reader: str | None,
    yes: bool,
    out_folder: Path | None,
    json_file: str | None,
) -> None:
    """From a folder of logs to a verdict.

    Drafts machine.toml and recipe.toml from the data, asks what they do not show, ingests the logs, prints what they show of
    each axis without a model, and runs the gap. Files that are there already are used as they are.
    """
    from sysid.cli.gap import gap
    from sysid.cli.gap_tables import show_responses
    from sysid.cli.ingest import ingest
    from sysid.datasets import Store
    from sysid.machine import load_machine
    from sysid.names import slug

    out, place = Printer(json_file), out_folder or folder
    name = name or slug(folder.resolve().name, "machine").replace("-", "_")
    files, described = {key: place / key for key in ("machine.toml", "recipe.toml")}, None
    there, made = [path for path in files.values() if path.exists()], list[Path]()
    if there == [files["recipe.toml"]]:
        remedy = f"Put the machine's description there, or remove {there[0]} to have both drafted."
        raise SettingsError(f"sysid start {folder}", f"{there[0]} without machine.toml", "both, or neither", remedy)
    for path in there:
        out.line(f"kept  {path}")
    if not there:
        drafted, beside = _robot_files(robot, name, kind) if robot is not None else (None, {})
        described = _described(out, folder, name, drafted, kind, answers, reader, yes)
        root = Root(place)
        root.make("")
        for key, text in {**beside, "recipe.toml": described.recipe, "machine.toml": described.machine}.items():
            root.write(key, text.encode("utf-8"))
            made.append(place / key)
            out.line(f"made  {place / key}")
    name = load_machine(files["machine.toml"]).name
    recipe = files["recipe.toml"] if files["recipe.toml"].exists() else None  # without one the columns have canonical names
    out.line()
    context.invoke(
        ingest, paths=(folder,), machine=files["machine.toml"], recipe=recipe, name=name, to=None, role=None,
        inspect=False, draft=None, reader=None, dbc=None, propose_frame=False, workers=1, cluster=None, trusted_network=False,
        json_file=None,
    )  # fmt: skip
    dataset = Store(context.obj).load(name)
    out.line()
    responses = show_responses(out, dataset)
    out.line()
    result = Path(json_file) if json_file is not None else None
    context.invoke(
        gap, reference=dataset.reference, plant=None, simulator=None, assets=(), out_file=None, localise=False, add=False,
        world=None, carry=False, forms="all", accept=(), workers=1, cluster=None, trusted_network=False, verbose=False,
        json_file=str(result.with_suffix(".gap.json")) if result is not None else None,
    )  # fmt: skip
    out.line()
    out.line("Next:")
    out.line(f"  1. Correct {files['machine.toml']} where a comment is wrong, and {command('start', folder)} again.")
    out.line(f"  2. {command('report', dataset.reference, workspace=context.obj)}")
    out.line(f"  3. {command('gap', dataset.reference, workspace=context.obj)} --add, to store the repaired simulation.")
    questions = [] if described is None else described.questions
    write_json(json_file, {
        "schema": 1, "dataset": dataset.reference, "made": made, "responses": responses,
        "questions": [{"key": q.key, "proposal": q.proposal, "why": q.why} for q in questions],
        "left_out": [] if described is None else list(described.left_out),
    })  # fmt: skip


def _described(
    out: Printer,
    folder: Path,
    name: str,
    robot: tuple[str, Machine] | None,
    kind: str | None,
    answers: tuple[str, ...],
    reader: str | None,
    yes: bool,
) -> Description:
    """The drafted files; questions are answered by ``--set``, at a prompt, or with ``--yes`` by their proposals."""
    from sysid.datasets.drafting import describe
    from sysid.datasets.drafting.question import Answers
    from sysid.logs.inspection import inspect_file

    given = dict(_pair(text) for text in answers)
    rate_hz = number(given.pop("rate_hz"), Positive, "--set rate_hz") if "rate_hz" in given else None
    paths, summaries = log_files((folder,), reader), []
    with progress_bar("look") as progress:
        for done, path in enumerate(paths):
            progress(done / len(paths), path.name)
            summaries.append(inspect_file(path, reader, rate_hz=rate_hz))
        found = describe(summaries, folder, name, Answers(given), kind, robot)
    while found.questions and not yes and sys.stdin.isatty():
        for question in found.questions:
            out.entry(f"{question.why}.")
            choice = click.Choice(question.choices) if question.choices else None
            given[question.key] = click.prompt(question.key, default=question.proposal, type=choice)
        found = describe(summaries, folder, name, Answers(given, frozenset(given)), kind, robot)
    for axis in found.axes:
        out.line(f"axis  {axis}")
    for line in found.left_out:
        out.entry(f"left out: {line}")
    for question in found.questions:
        choices = f" ({', '.join(question.choices)})" if question.choices else ""
        out.entry(f"? {question.why}. Proposed: --set {question.key}={question.proposal}{choices}")
    if found.questions and not yes:
        keys = " ".join(f"--set {q.key}={q.proposal}" for q in found.questions)
        raise SettingsError(f"sysid start {folder}", "open questions", "an answer to each", f"Add {keys}, or --yes.")
    return found


def _pair(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals or not key or not value:
        raise SettingsError(f"--set {text}", "no KEY=VALUE", "for example --set unit=mm")
    return key, value


def _robot_files(robot: Path, name: str, kind: str | None) -> tuple[tuple[str, Machine], dict[str, str]]:
    """``machine.toml`` from a robot's file with the machine, and the files beside it."""
    from sysid.cli.init_from import Choices, drafted_apart
    from sysid.machine import machine_from_files

    files = dict(drafted_apart(robot, name, Choices(kind)).files)
    del files["recipe.toml"]
    machine = machine_from_files(files, name)
    text = files.pop("machine.toml")
    return (text, machine), files
