"""``sysid start FOLDER``: from a folder of logs to a verdict."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from sysid.cli.init import KINDS
from sysid.cli.output import FILE, FOLDER, Printer, command, json_option
from sysid.errors import SettingsError

if TYPE_CHECKING:
    from sysid.datasets.drafting import Description


@click.command()
@click.argument("folder", metavar="FOLDER", type=FOLDER)
@click.option("--name", help="Name of the machine and of its dataset; the folder's name if left out.")
@click.option("--robot", metavar="FILE", type=FILE, help="The machine's URDF or MJCF: axes, limits, masses.")
@click.option(
    "--kind",
    type=click.Choice(KINDS),
    help="What the commands are: speeds (hydraulic), positions (servo) or forces (force); as the data show if left out.",
)
@click.option(
    "--set",
    "answers",
    multiple=True,
    metavar="KEY=VALUE",
    help="The answer to a question that start has asked; may be repeated.",
)
@click.option("--reader", help="Read all files as this format, where their suffix does not say which (json).")
@click.option("--yes", is_flag=True, help="Take the proposal of every question.")
@click.option(
    "--out",
    "out_folder",
    metavar="DIR",
    type=FOLDER,
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
    out: Printer,
) -> None:
    """From a folder of logs to a verdict.

    Drafts machine.toml and recipe.toml from the data, asks what they do not show, ingests the logs, prints what they show of
    each axis without a model, and runs the gap. Files that are there already are used as they are.
    """
    from sysid.cli.gap import gap
    from sysid.cli.gap_tables import show_responses
    from sysid.cli.ingest import ingest
    from sysid.datasets import Store
    from sysid.front import logs
    from sysid.machine import load_machine

    place = out_folder or folder
    described, made, machine = None, list[Path](), place / "machine.toml"
    if logs.described_already(place, f"sysid start {folder}"):
        for path in filter(None, (machine, logs.recipe_in(place))):
            out.line(f"kept  {path}")
    else:
        ask = partial(_asked, out) if sys.stdin.isatty() and not yes else None
        drafted = logs.draft(folder, name, robot, kind, dict(map(_pair, answers)), reader, ask=ask)
        described = drafted.description
        _show_description(out, described, folder, yes)
        made = drafted.write(place)
        for path in made:
            out.line(f"made  {path}")
    name = load_machine(machine).name
    recipe = logs.recipe_in(place)
    out.line()
    context.invoke(ingest, paths=(folder,), machine=machine, recipe=recipe, name=name, out=Printer())
    dataset = Store(context.obj).load(name)
    out.line()
    responses = show_responses(out, dataset)
    out.line()
    gap_file = str(Path(out.json_file).with_suffix(".gap.json")) if out.json_file is not None else None
    context.invoke(gap, reference=dataset.reference, out=Printer(gap_file))
    out.line()
    out.line("Next:")
    out.line(f"  1. Correct {machine} where a comment is wrong, and {command('start', folder)} again.")
    out.line(f"  2. {command('report', dataset.reference, workspace=context.obj)}")
    out.line(f"  3. {command('gap', dataset.reference, workspace=context.obj)} --add, to store the repaired simulation.")
    questions = [] if described is None else described.questions
    out.json({
        "schema": 1, "dataset": dataset.reference, "made": made, "responses": responses,
        "questions": [{"key": q.key, "proposal": q.proposal, "why": q.why} for q in questions],
        "left_out": [] if described is None else list(described.left_out),
    })  # fmt: skip


def _asked(out: Printer, found: Description) -> dict[str, str]:
    """The answers to all questions of a description, at a prompt."""
    given = {}
    for question in found.questions:
        out.entry(f"{question.why}.")
        choice = click.Choice(question.choices) if question.choices else None
        given[question.key] = str(click.prompt(question.key, default=question.proposal, type=choice))
    return given


def _show_description(out: Printer, found: Description, folder: Path, yes: bool) -> None:
    """What was drafted, and the questions.

    Raises:
        SettingsError: questions are open, and their proposals are not taken.
    """
    for axis in found.axes:
        out.line(f"axis  {axis}")
    if found.kind is not None:
        from sysid.machine.sources.draft import KINDS as ARE

        out.line(f"commands are {ARE[found.kind]}")
    for line in found.left_out:
        out.entry(f"left out: {line}")
    for question in found.questions:
        choices = f" ({', '.join(question.choices)})" if question.choices else ""
        out.entry(f"? {question.why}. Proposed: --set {question.key}={question.proposal}{choices}")
    if found.questions and not yes:
        keys = " ".join(f"--set {q.key}={q.proposal}" for q in found.questions)
        raise SettingsError(f"sysid start {folder}", "open questions", "an answer to each", f"Add {keys}, or --yes.")


def _pair(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals or not key or not value:
        raise SettingsError(f"--set {text}", "no KEY=VALUE", "for example --set unit=mm")
    return key, value
