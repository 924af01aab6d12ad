"""The verbs of the command line: those of this package, and those that installed packages add.

A package adds a verb by an entry point of the group ``sysid.verbs``. Its name is that of the verb; its object is a
:class:`Verb`, in a module that is imported for ``sysid --help`` and has to be light::

    [project.entry-points."sysid.verbs"]
    weld = "weld_tools.verbs:WELD"

A package that shows files of its own in ``sysid view FILE`` adds an entry point of the group ``sysid.viewers``. Its name is the
file's suffix without the dot; its object is a function of the file, of the ``.rrd`` file to write instead of opening the
viewer (or None), and of the file of ``--json`` (or None).
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TypeVar

import click

from sysid.errors import SettingsError
from sysid.extras import extra_of

T = TypeVar("T")

GROUP, VIEWERS = "sysid.verbs", "sysid.viewers"
#: What loading a verb raises; the second where a package of an extra of this distribution is missing.
UNLOADED = (SettingsError, ModuleNotFoundError)


@dataclass(frozen=True)
class Verb:
    """Location of a verb's command, and its line in ``sysid --help``.

    Args:
        location: ``module:command``; imported when the verb is called.
        after: for a verb of another package, the one behind which it is listed; default: at the end.
    """

    location: str
    help: str
    after: str = ""


#: Verbs of this package, in the order of work.
VERBS: dict[str, Verb] = {
    "start": Verb("sysid.cli.start:start", "From a folder of logs to a verdict."),
    "init": Verb("sysid.cli.init:init", "Create the folders and templates for a machine."),
    "ingest": Verb("sysid.cli.ingest:ingest", "Turn raw logs into a new dataset version."),
    "datasets": Verb("sysid.cli.datasets:datasets", "List dataset versions, or show one."),
    "fit": Verb("sysid.cli.fit:fit", "Fit the actuator, motion or forward networks of a dataset."),
    "validate": Verb("sysid.cli.fit:validate", "Evaluate a fitted network on held-out recordings."),
    "models": Verb("sysid.cli.models:models", "List model versions, show, promote, compare or export one."),
    "gap": Verb("sysid.cli.gap:gap", "Name the effects that the simulation lacks."),
    "fleet": Verb("sysid.cli.fleet:fleet", "Compare many machines of one type, and watch them for drift."),
    "export": Verb("sysid.cli.export:export", "Write a plant for another simulator, with its replay."),
    "actuators": Verb("sysid.cli.actuators:actuators", "List the cards of identified actuators, or show one."),
    "view": Verb("sysid.cli.view:view", "Write a Rerun recording of the moving machine."),
    "report": Verb("sysid.cli.view:report", "Write the HTML report of a dataset."),
    "ui": Verb("sysid.cli.ui:ui", "Write the workspace as linked pages, or serve them."),
    "demo": Verb("sysid.cli.demo:demo", "Run the whole workflow on the shipped logs."),
}


def all_verbs() -> dict[str, Verb]:
    """All verbs in the order of ``sysid --help``; the line of one that does not load says why."""
    found, added = dict(VERBS), {}
    for name, entry in _added().items():
        try:
            added[name] = _verb(entry)
        except UNLOADED as error:
            added[name] = Verb("", str(error))
    while ready := [name for name, verb in added.items() if verb.after in found]:
        for name in ready:
            found = _inserted(found, name, added.pop(name))
    return found | added


def _inserted(verbs: dict[str, Verb], name: str, verb: Verb) -> dict[str, Verb]:
    items = list(verbs.items())
    items.insert(1 + list(verbs).index(verb.after), (name, verb))
    return dict(items)


def names() -> list[str]:
    """Names of all verbs, without loading any: those of this package first."""
    return [*VERBS, *_added()]


def command(name: str) -> click.Command | None:
    """The command of a verb, None if there is none of this name.

    Raises:
        SettingsError: it is a verb of another package, and does not load.
        ModuleNotFoundError: it needs a package of an extra of this distribution.
    """
    if name in VERBS:
        return _command(VERBS[name])
    entry = _added().get(name)
    if entry is None:
        return None
    verb = _verb(entry)
    return _loaded(entry, lambda: _command(verb))


def viewer(suffix: str) -> Callable[[Path, Path | None, str | None], None] | None:
    """What shows files with this suffix (``.mcap``); None if nothing does.

    Raises:
        SettingsError: it does not load.
        ModuleNotFoundError: it needs a package of an extra of this distribution.
    """
    entries = [*entry_points(group=VIEWERS, name=suffix.removeprefix("."))] if suffix else []
    return _loaded(entries[0], entries[0].load) if entries else None


def _added() -> dict[str, EntryPoint]:
    """Entry points of verbs by name. A verb of this package keeps its name; of two packages, the first one on the path."""
    return {entry.name: entry for entry in reversed([*entry_points(group=GROUP)]) if entry.name not in VERBS}


def _verb(entry: EntryPoint) -> Verb:
    found: object = _loaded(entry, entry.load)
    if not isinstance(found, Verb):
        raise _refused(entry, f"is of type {type(found).__name__}, not a sysid.cli.verbs.Verb")
    return found


def _command(verb: Verb) -> click.Command:
    module, _, attribute = verb.location.partition(":")
    found: object = getattr(importlib.import_module(module), attribute)
    if not isinstance(found, click.Command):
        raise TypeError(f"{verb.location} is no command of click")
    return found


def _loaded(entry: EntryPoint, load: Callable[[], T]) -> T:
    """What ``load`` returns; errors of the package of the entry point name it."""
    try:
        return load()
    except Exception as error:
        if isinstance(error, ModuleNotFoundError) and extra_of(error):
            raise  # the command line says which extra installs it
        raise _refused(entry, f"does not load ({type(error).__name__}: {error})") from error


def _refused(entry: EntryPoint, found: str) -> SettingsError:
    package = entry.dist.name if entry.dist is not None else entry.module
    what = "verb" if entry.group == GROUP else "viewer"
    remedy = f"Update or remove {package}; everything else works without it."
    return SettingsError(f"{what} {entry.name!r} of the package {package}", f"{entry.value} {found}", "", remedy)
