"""``sysid init DIR``: folders for a machine, with templates of its description and recipe."""

from __future__ import annotations

import re
from importlib.resources import files as package_files
from pathlib import Path
from string import Template

import click

from sysid.cli.output import FILE, FOLDER, Printer, command, json_option
from sysid.datasets.robot_files import Choices, drafted_apart
from sysid.errors import SettingsError
from sysid.names import listed, slug
from sysid.root import Root

FOLDERS = {
    "datasets": "One folder per machine: machine.toml, recipe.toml, raw logs under logs/<recording>/. Read by sysid.datasets.",
    "pipelines": "Whole workflows as short Python files that use the public API of sysid.",
    "rl": "One folder per machine: training and runner recipes. Read by sysid train and sysid run.",
    "reports": "Reference results, each with its command, seed and versions. Shown by sysid.reports.",
}

#: Kinds of machine, by how it is driven; each has two files in ``templates/``.
KINDS = ("hydraulic", "servo", "force")


def template(kind: str, file: str, name: str) -> str:
    """The text of ``machine`` or ``recipe`` for a machine ``name`` of one of :data:`KINDS`."""
    text = package_files("sysid.cli").joinpath("templates", f"{kind}-{file}.toml").read_text("utf-8")
    return Template(text).substitute(name=name)


def _template_of(kind: str | None) -> str:
    """The kind of the files in ``templates/``: without a description, a servo is described by its response."""
    return "servo" if kind == "response" else kind or "hydraulic"


@click.command()
@click.argument("directory", metavar="DIR", type=FOLDER)
@click.option("--name", help="Name of the machine; the folder's name if left out.")
@click.option(
    "--kind",
    type=click.Choice((*KINDS, "response")),
    help="What the commands are: valve openings or speeds (hydraulic, the default), positions (servo), forces (force). "
    "With --from an MJCF, response describes servos by their responses instead of their controllers.",
)
@click.option(
    "--from",
    "source",
    metavar="FILE",
    type=FILE,
    help="Describe the machine from its URDF or MJCF: axes, limits, actuators, masses, friction.",
)
@click.option("--base", metavar="NAME", help="With --from: the link or body that is held still, as on a stand.")
@click.option("--tip", metavar="NAME", help="With --from: the end effector, a link (URDF), site or body (MJCF).")
@click.option("--tool", metavar="NAME", help="With --from: the link or body of a hanging tool.")
@click.option(
    "--assets",
    multiple=True,
    metavar="DIR",
    type=FOLDER,
    help="With --from: a folder beside that of the MJCF whose files it may open; repeat it for several.",
)
@json_option
def init(
    directory: Path,
    name: str | None,
    kind: str | None,
    source: Path | None,
    base: str | None,
    tip: str | None,
    tool: str | None,
    assets: tuple[Path, ...],
    out: Printer,
) -> None:
    """Create the folders and templates for a machine in DIR. Existing files are not changed."""
    name = name or _name_of(directory)
    if not re.fullmatch(r"[a-z0-9][a-z0-9_-]*", name):
        raise SettingsError("--name", f"{name!r}", "lower-case letters, digits, '-' and '_'")
    if source is None and any((base, tip, tool, assets)):
        raise SettingsError("sysid init", "--base, --tip, --tool or --assets without --from", "--from with a URDF or an MJCF")
    files = {f"{folder}/README.md": f"# {folder}/\n\n{text}\n" for folder, text in FOLDERS.items()}
    drafted = None
    if source is None:
        own = {f"{file}.toml": template(_template_of(kind), file, name) for file in ("machine", "recipe")}
    else:
        drafted = drafted_apart(source, name, Choices(kind, base, tip, tool, assets))
        own = dict(drafted.files)
    files |= {f"datasets/{name}/{file}": text for file, text in own.items()}
    files[".gitignore"] = "/workspace/\n"
    made, kept, root = [], [], Root(directory)
    for relative, text in files.items():
        root.make(relative.rpartition("/")[0])
        if root.kind(relative) is not None:
            kept.append(relative)
        else:
            root.write(relative, text.encode("utf-8"))
            made.append(relative)
    root.make(f"datasets/{name}/logs")
    for relative in made:
        out.line(f"made  {directory / relative}")
    for relative in kept:
        out.line(f"kept  {directory / relative}")
    left_out, assumed = ((), ()) if drafted is None else (drafted.left_out, drafted.assumed)
    if drafted is not None:
        count = "1 axis" if len(drafted.axes) == 1 else f"{len(drafted.axes)} axes"
        out.entry(f"{count}, {listed(drafted.axes)}, to the end effector {drafted.tip}")
    for line in left_out:
        out.entry(f"left out: {line}")
    for line in assumed:
        out.entry(f"assumed: {line}")
    folder = directory / "datasets" / name
    do = "describe" if source is None else "check"
    out.line(f"Next: {do} the machine in {folder / 'machine.toml'}, put logs into {folder / 'logs'}/<recording>/, then")
    out.line(f"      {command('ingest', folder)}")
    found = {"made": made, "kept": kept, "left_out": list(left_out), "assumed": list(assumed)}
    out.json({"schema": 1, "directory": directory, "name": name, **found})


def _name_of(directory: Path) -> str:
    """The name of a folder's machine; where an earlier version has made one with another name, that one."""
    text = directory.resolve().name
    before = re.sub(r"[^a-z0-9_-]+", "-", text.lower()).strip("-") or "machine"
    return before if (directory / "datasets" / before / "machine.toml").is_file() else slug(text, "machine")
