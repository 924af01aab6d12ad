"""Logs → dataset version, and from a folder of logs to a verdict."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sysid.errors import SettingsError, UnknownDriveError
from sysid.front.place import Place, location_of, shown
from sysid.numbers import Positive, number
from sysid.root import Root

if TYPE_CHECKING:
    from sysid.datasets import Dataset, Role
    from sysid.datasets.drafting import Description
    from sysid.execution import Executor
    from sysid.front.gap import GapResult
    from sysid.machine import Machine
    from sysid.progress import Progress

FilePath = str | os.PathLike[str]
#: What drafting asks → further answers; empty where there are none.
Ask = Callable[["Description"], Mapping[str, str]]


def ingest(
    paths: FilePath | Sequence[FilePath],
    workspace: Place = None,
    *,
    machine: FilePath | None = None,
    recipe: FilePath | None = None,
    name: str | None = None,
    append_to: str | None = None,
    role: Role | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Dataset:
    """Read logs and store them as a new dataset version; equal logs give the same version.

    Args:
        paths: folder ``DIR`` with ``DIR/<recording>/<log files>``, log file, or several of them.
        workspace: see :func:`sysid.open`.
        machine, recipe, name: files and name of the dataset, by default as :func:`sysid.datasets.ingest` finds them.
        append_to: ``name`` or ``name@3``: only recordings that it does not hold are read, and added in ``role``.
        progress: called with the share done and a text; by default a bar is shown.
        executor: reads recordings in other processes.

    Raises:
        InputError: a log that cannot be used.
        SettingsError: a mistake in ``machine.toml`` or in the recipe, or ``role`` without ``append_to``.
        StorageError: the disk is full.
    """
    from sysid import datasets

    if append_to is not None and name is not None:
        raise SettingsError("--name", f"{name!r} with --append", "one of them", "The new version keeps the name.")
    if role is not None and append_to is None:
        raise SettingsError("--role", "given without --append", "both, or neither", "Name roles in the recipe's [splits].")
    files = [Path(path) for path in ([paths] if isinstance(paths, str | os.PathLike) else paths)]
    described = (_path(machine), _path(recipe))
    with shown(progress, "ingest") as report:
        if append_to is not None:
            return datasets.append(files, location_of(workspace), append_to, *described, role, report, executor)
        return datasets.ingest(files, location_of(workspace), *described, name, report, executor)


def _path(path: FilePath | None) -> Path | None:
    return None if path is None else Path(path)


def start(
    folder: FilePath,
    workspace: Place = None,
    *,
    name: str | None = None,
    robot: FilePath | None = None,
    kind: str | None = None,
    answers: Mapping[str, str] | None = None,
    accept_proposals: bool = False,
    reader: str | None = None,
    out: FilePath | None = None,
    progress: Progress | None = None,
) -> GapResult:
    """From a folder of logs to a verdict: draft ``machine.toml`` and ``recipe.toml``, ingest, find the gap.

    Files that are there already are used as they are. Proposals that are taken, and what is left out, are warnings.

    Args:
        name: of the machine and its dataset; default: the folder's.
        robot: URDF or MJCF of the machine.
        kind: hydraulic, servo or force; default: as the data show.
        answers: key of a question → answer; ``accept_proposals``: the proposals of all others.
        reader: reads all files, where their suffix does not say which.
        out: folder of the two files; default: ``folder``.

    Raises:
        SettingsError: a question without an answer.
        InputError: no log files, or no axis in them.
    """
    from sysid.front.gap import find_gap
    from sysid.machine import load_machine

    logs, place = Path(folder), Path(out if out is not None else folder)
    if not described_already(place, f"start {logs}"):
        drafted = draft(logs, name, _path(robot), kind, answers or {}, reader, progress)
        questions = drafted.description.questions
        if questions and not accept_proposals:
            asked = "; ".join(f"{each.why} ({each.key}, proposed {each.proposal!r})" for each in questions)
            remedy = "Give answers={key: value}, or accept_proposals=True."
            raise SettingsError(f"start {logs}", f"open questions: {asked}", "an answer to each", remedy)
        for each in questions:
            warnings.warn(f"{each.why}. Taken: {each.key}={each.proposal}", stacklevel=2)
        for text in drafted.description.left_out:
            warnings.warn(f"left out: {text}", stacklevel=2)
        drafted.write(place)
    machine = place / "machine.toml"
    dataset = ingest(
        logs, workspace, machine=machine, recipe=recipe_in(place), name=load_machine(machine).name, progress=progress
    )
    return find_gap(dataset, workspace=workspace, progress=progress)


def described_already(place: Path, where: str) -> bool:
    """Whether ``machine.toml`` is in a folder.

    Raises:
        SettingsError: ``recipe.toml`` is there without it.
    """
    described = (place / "machine.toml").exists()
    if (place / "recipe.toml").exists() and not described:
        remedy = f"Put the machine's description there, or remove {place / 'recipe.toml'} to have both drafted."
        raise SettingsError(where, f"{place / 'recipe.toml'} without machine.toml", "both, or neither", remedy)
    return described


def recipe_in(place: Path) -> Path | None:
    """The recipe in a folder; without one the columns have canonical names."""
    return place / "recipe.toml" if (place / "recipe.toml").exists() else None


@dataclass(frozen=True)
class Draft:
    """A drafted machine.

    Args:
        beside: further files, name → text.
    """

    description: Description
    beside: Mapping[str, str]

    def write(self, place: Path) -> list[Path]:
        """Write the files into a folder, which is made; returns their paths."""
        root = Root(place)
        root.make("")
        texts = {**self.beside, "recipe.toml": self.description.recipe, "machine.toml": self.description.machine}
        for key, text in texts.items():
            root.write(key, text.encode("utf-8"))
        return [place / key for key in texts]


def draft(
    folder: Path,
    name: str | None,
    robot: Path | None,
    kind: str | None,
    answers: Mapping[str, str],
    reader: str | None,
    progress: Progress | None = None,
    ask: Ask | None = None,
) -> Draft:
    """Draft the files of a machine from its logs, without writing them.

    Args:
        ask: called with a description that has questions, until it has none or there is no further answer.
    """
    from sysid.datasets.drafting import describe
    from sysid.datasets.drafting.fields import Answers
    from sysid.logs.inspection import inspect_file, log_files
    from sysid.names import slug

    name = name or slug(folder.resolve().name, "machine").replace("-", "_")
    drafted, beside, unstated = None, dict[str, str](), None
    if robot is not None:
        try:
            drafted, beside = _robot_files(robot, name, kind)
        except UnknownDriveError as error:  # as the data show, then
            unstated = error
    given = dict(answers)
    rate_hz = number(given.pop("rate_hz"), Positive, "--set rate_hz") if "rate_hz" in given else None
    paths, summaries = log_files((folder,), reader), []
    with shown(progress, "look") as report:
        for done, path in enumerate(paths):
            report(done / len(paths), path.name)
            summaries.append(inspect_file(path, reader, rate_hz=rate_hz))
    found = describe(summaries, folder, name, Answers(given), kind, drafted)
    if robot is not None and unstated is not None:
        unsure = any(question.key.endswith("actuation") for question in found.questions)
        if found.kind is None or unsure:
            raise unstated
        drafted, beside = _robot_files(robot, name, found.kind)
        found = describe(summaries, folder, name, Answers(given), kind, drafted)
    while ask is not None and found.questions and (further := ask(found)):
        given |= further
        found = describe(summaries, folder, name, Answers(given, frozenset(given)), kind, drafted)
    return Draft(found, beside)


def _robot_files(robot: Path, name: str, kind: str | None) -> tuple[tuple[str, Machine], dict[str, str]]:
    """``machine.toml`` from a robot's file with the machine, and the files beside it."""
    from sysid.datasets.robot_files import Choices, drafted_apart
    from sysid.machine import machine_from_files

    files = dict(drafted_apart(robot, name, Choices(kind)).files)
    del files["recipe.toml"]
    machine = machine_from_files(files, name)
    text = files.pop("machine.toml")
    return (text, machine), files
