"""Appends recordings to a version: only the new ones are read and written; the existing version does not change."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from glob import escape
from pathlib import Path
from typing import Any, get_args

import numpy as np

from sysid.datasets.channels import Mounts, survey_mounts
from sysid.datasets.clocks.records import known_skews
from sysid.datasets.discover import RecordingFiles, check_sources, discover
from sysid.datasets.ingestion import DESCRIBED, STORED, read_and_align
from sysid.datasets.plan import Plan, content_of, plan_of, sources_of
from sysid.datasets.recipe import NO_RECIPE, Splits, stored_recipe
from sysid.datasets.recording import Dataset, Recording, Role, Source
from sysid.datasets.splits import split
from sysid.datasets.tasks.driver import Survey, TaskIngest
from sysid.datasets.versions.files import OvertakenError, working_on
from sysid.datasets.versions.manifest import Manifest, clock_from, digest_of, files_of
from sysid.datasets.versions.store import Store
from sysid.errors import InputError, SettingsError, nearest
from sysid.execution import Executor
from sysid.machine import machine_from_files
from sysid.progress import Progress, silent
from sysid.progress import part as stretch

#: Of new recordings without a role from the caller or the recipe, so that held-out recordings stay the same.
DEFAULT_ROLE: Role = "fit"


def append(
    paths: Sequence[Path | str] | Path | str,
    workspace: Path | str,
    to: str,
    machine: Path | str | None = None,
    recipe: Path | str | None = None,
    role: Role | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Dataset:
    """Read the recordings that ``to`` does not hold yet, and store it with them as the next version.

    Nothing of ``to`` is read again or rewritten: the new version refers to its tables and one more. Its recordings keep their
    roles. A new recording has ``role``, else that of the splits in the recipe, else :data:`DEFAULT_ROLE`. Skews of clocks and
    mounts of rigid bodies (with one reference pose for all recordings) are taken from ``to``.

    If ``to`` has no number and another version is stored in the meantime, the step is repeated on that version, so that each of
    several concurrent appends is stored.

    Args:
        paths: folders of recordings or log files; recordings that ``to`` holds may be among them.
        workspace: folder or object-store URL.
        to: ``name`` (its newest version) or ``name@3``.
        machine: has to equal the description of ``to``, which is the default.
        recipe: ``recipe.toml``; else the one beside the logs, else the last one of ``to``.
        role: of the new recordings.
        progress: called with the share done and a text.
        executor: as of :func:`sysid.datasets.ingest`.

    Returns:
        The new version; ``to`` where nothing is new.

    Raises:
        InputError: a log that cannot be used, or a recording that ``to`` holds with other content or under another name.
        SettingsError: another machine, a mistake in the recipe, an unknown role.
        StoreError: no such version.
    """
    if role is not None and role not in get_args(Role):
        raise SettingsError("role", repr(role), nearest(role, get_args(Role)))
    report = progress or silent
    with working_on(workspace):
        while True:
            try:
                return _append(paths, Store(workspace), to, machine, recipe, role, report, executor)
            except OvertakenError as error:  # each time another writer has stored a version, so that this ends
                report(0.0, f"{error.found}: repeated on that version")


def _append(
    paths: Sequence[Path | str] | Path | str,
    store: Store,
    to: str,
    machine: Path | str | None,
    recipe: Path | str | None,
    role: Role | None,
    report: Progress,
    executor: Executor | None,
) -> Dataset:
    base = store.manifest(to)
    name, reference = base["name"], f"{base['name']}@{base['version']}"
    plan = plan_on(base, paths, machine, recipe)
    report(0.0, "reading file names")
    found, sources = _new_recordings(discover(plan.roots, plan.rules), base["sources"], reference)
    if not found:
        report(1.0, f"{reference} holds all of these recordings")
        return store.load(reference)
    check_sources(found, plan.where)
    digest = digest_of({"base": base["digest"], "role": role, **content_of(sources, plan.rules)})
    known = store.intact(name, digest, base["version"])
    if known is not None:
        report(1.0, f"the same recordings on {reference} are {known.reference}")
        return known

    skews = known_skews([clock_from(item) for item in base["clocks"]], store.clock_domains(reference))

    def divide(recordings: Sequence[Recording]) -> tuple[tuple[Recording, ...], dict[str, Role]]:
        return split(recordings, roles_of(recordings, plan.rules.splits, role), plan.where)

    newest = "@" not in to
    if executor is not None:
        with store.new_part(name, digest) as folder, executor.kept() as kept:
            tasks = TaskIngest(kept, store)
            mounts = mounts_of(found, base, lambda open_files: tasks.survey(open_files, plan, report))
            dataset, entry = tasks.written(found, plan, mounts, sources, divide, folder, report, skews)
            addition = checked_addition(replace(dataset, name=name, digest=digest), base, plan)
            number = store.publish(addition, entry, reference, newest)
    else:
        mounts = mounts_of(found, base, lambda open_files: survey_mounts(open_files, plan.machine, plan.recipe_place))
        ingested = read_and_align(found, plan, mounts, report, skews)
        parts, roles = divide(ingested.recordings)
        dataset = ingested.dataset(plan, parts, roles, sources, stretch(report, *DESCRIBED))
        addition = checked_addition(replace(dataset, name=name, digest=digest), base, plan)
        number = store.append(reference, addition, ingested.channels, ingested.made, newest, stretch(report, *STORED))
    report(1.0, f"stored {name}@{number}")
    return store.load(f"{name}@{number}")


def checked_addition(addition: Dataset, base: Manifest, plan: Plan) -> Dataset:
    """The new recordings with the quality of all.

    Args:
        base: the manifest that they are added to.

    Raises:
        InputError: a signal with another unit than in ``base``.
    """
    for signal, unit in addition.units.items():
        if base["units"].get(signal, unit) != unit:
            expected = f"[{base['units'][signal]}] as in {base['name']}@{base['version']}"
            raise InputError(f"{plan.where}: {signal}", f"[{unit}]", expected, "Correct the unit in the recipe.")
    return replace(addition, quality=joined_quality(base["quality"], addition.quality))


def plan_on(
    base: Manifest,
    paths: Sequence[Path | str] | Path | str,
    machine: Path | str | None = None,
    recipe: Path | str | None = None,
) -> Plan:
    """Recipe and machine of recordings that are to be added to ``base``: those named, else those beside the logs, else its own.

    Raises:
        SettingsError: another machine than that of ``base``, or a mistake in the recipe.
    """
    reference, text = f"{base['name']}@{base['version']}", base["parts"][-1]["made"]["recipe"]
    expected = machine_from_files(base["machine"], f"dataset {reference}")
    plan = plan_of(paths, machine, recipe, lambda: stored_recipe(text, f"{reference}: recipe") if text else NO_RECIPE, expected)
    ours, theirs = expected.files(), plan.machine.files()
    if ours == theirs:
        return plan
    file = next(name for name in {**ours, **theirs} if ours.get(name) != theirs.get(name))
    lines = difflib.ndiff(ours.get(file, "").splitlines(), theirs.get(file, "").splitlines())
    first = next((line for line in lines if line.startswith(("- ", "+ "))), "")
    raise SettingsError(
        file,
        f"another machine than in {reference}: {first!r}",
        "the description that the version was made with",
        "Ingest all recordings again with the new description, or leave --machine out and no machine.toml beside the logs.",
    )


def _new_recordings(
    found: Sequence[RecordingFiles], held: Sequence[Mapping[str, Any]], reference: str
) -> tuple[tuple[RecordingFiles, ...], tuple[Source, ...]]:
    """The recordings that are not among the sources ``held``, with their own sources.

    Raises:
        InputError: a recording that is held with other content, or the same content under another name.
    """
    before = {name: {file: entry["sha256"] for file, entry in own.items()} for name, own in files_of(held).items()}
    names = {frozenset(files.values()): recording for recording, files in before.items()}
    new: list[RecordingFiles] = []
    sources: list[Source] = []
    for files in found:
        own = sources_of([files])
        content = {source.path.rpartition("/")[2]: source.sha256 for source in own}
        if content.items() <= before.get(files.name, {}).items():  # the recipe may map fewer of its files
            continue
        if files.name in before:
            raise InputError(
                f"recording {files.name}",
                f"other content than in {reference}, which holds a recording of this name",
                "a recording that is new",
                "Give its folder another name; a version never changes.",
            )
        same = names.get(frozenset(content.values()))
        if same is not None:
            found_text = f"the same files as recording {same!r} of {reference}"
            raise InputError(
                f"recording {files.name}", found_text, "a recording that is new", "It would count twice: leave it out."
            )
        new.append(files)
        sources += own
    return tuple(new), tuple(sources)


def mounts_of(found: Sequence[RecordingFiles], base: Manifest, survey: Survey) -> Mounts:
    """Mounts of the bodies: those of ``base`` with one reference pose for all recordings, else from the recordings."""
    known: dict[str, dict[str, Any]] = {}
    for part in base["parts"]:
        known |= part["made"]["mounts"]
    mounts: dict[tuple[str, str], dict[str, Any]] = {}
    open_files = []
    for files in found:
        rest = []
        for path, stream in files.streams:
            shared = stream is not None and stream.reference is not None and stream.reference.recording is not None
            if stream is not None and shared and {*stream.bodies} <= {*known.get(stream.key, ())}:
                poses = known[stream.key]
                mounts[files.name, stream.key] = {body: np.array(poses[body], dtype=np.float64) for body in stream.bodies}
            else:
                rest.append((path, stream))
        open_files.append(replace(files, streams=tuple(rest)))
    return {**survey(open_files), **mounts}


def roles_of(recordings: Sequence[Recording], splits: Splits, role: Role | None) -> Splits:
    """The splits for ``recordings``: all ``role`` if given, else those of the recipe, else the default."""
    names = [recording.name for recording in recordings if recording.kind == "motion"]
    if role is not None:
        return Splits(**{role: tuple(map(escape, names))}, guard_s=splits.guard_s)  # type: ignore[arg-type]
    last = {name: share for name, share in splits.held_out_last.items() if name in names}
    named: dict[str, list[str]] = {"fit": [], "select": [], "held_out": []}
    for key, chosen in named.items():
        patterns = getattr(splits, key)
        chosen += [name for name in names if any(fnmatchcase(name, pattern) for pattern in patterns)]
    taken = {name for chosen in named.values() for name in chosen} | {*last}
    named[DEFAULT_ROLE] += [name for name in names if name not in taken]
    fit, select, held_out = (tuple(map(escape, named[key])) for key in ("fit", "select", "held_out"))
    return Splits(fit=fit, select=select, held_out=held_out, held_out_last=last, guard_s=splits.guard_s)


def joined_quality(base: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """Entries by recording of both; lists are concatenated, each note once."""
    joined = dict(base)
    for key, value in more.items():
        earlier = base.get(key)
        if isinstance(earlier, Mapping) and isinstance(value, Mapping):
            joined[key] = {**earlier, **value}
        elif isinstance(earlier, list) and isinstance(value, list | tuple):
            joined[key] = [*earlier, *(item for item in value if not isinstance(item, str) or item not in earlier)]
        else:
            joined[key] = value
    return joined
