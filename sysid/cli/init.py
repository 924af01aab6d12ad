"""``sysid init DIR``: folders for a machine, with templates of its description and recipe."""

from __future__ import annotations

import re
from pathlib import Path

import click

from sysid.cli.output import Printer, command, json_option, write_json
from sysid.errors import SettingsError
from sysid.names import slug
from sysid.root import Root

FOLDERS = {
    "datasets": "One folder per machine: machine.toml, recipe.toml, raw logs under logs/<recording>/. Read by sysid.datasets.",
    "pipelines": "Whole workflows as short Python files that use the public API of sysid.",
    "rl": "One folder per machine: training and runner recipes. Read by sysid.rl.",
    "reports": "Reference results, each with its command, seed and versions. Shown by sysid.reports.",
}

MACHINE = """\
# The machine: its axes in kinematic order, and the effects of the nominal simulation. SI units throughout.
schema = 1
name = "{name}"
rate_hz = 100.0                  # grid that all signals are resampled to
# urdf = "{name}.urdf"           # geometry; needed for the end effector, the tool and gravity
# tip = "boom_tip"               # URDF link whose origin is the end effector
# tool = "gripper"               # URDF link of a hanging tool, if it is measured

[[axes]]
name = "boom"                    # signals are called boom.command, boom.cylinder, boom.joint
actuation = "velocity"           # velocity (valve) | position (servo) | force
drives = "cylinder"              # what the command moves: cylinder | joint
gain = 0.050                     # speed at command 1.0 [m/s]
stroke = [0.0, 0.165]            # cylinder ends [m]
# joint = "boom_joint"           # URDF joint; its limits are the axis limits
limits = [-0.4, 1.4]             # without a URDF: joint limits [rad]

# [noise]                        # standard deviation per signal from the data sheet; else estimated from still phases
# "boom.cylinder" = 1e-4

# [[effects]]                    # what the nominal simulation already contains
# name = "first_order_lag"
# target = "boom"
# parameters = {{ time_constant = 0.06 }}
"""

RECIPE = """\
# Which topic or column is which signal. Not needed where CSV headers are the canonical names (boom.command, boom.cylinder [mm])
schema = 1
name = "{name}"
machine = "machine.toml"         # relative to this file; paths never leave this folder
logs = "logs"                    # logs/<recording>/<files>, each file with its own clock

# [splits]                       # else chosen automatically, by recording
# held_out = ["day-2-*"]         # used only for the final proof

[[streams]]
files = "*.csv"                  # inside each recording's folder: logs/<recording>/
reader = "csv"                   # mcap | motive | csv | mat; by suffix if left out
domain = "machine"               # files of one clock share a domain; every other domain is aligned to "machine"
[streams.signals]
"boom.command" = {{ field = "joystick_y", scale = 0.01 }}          # per cent → 1
"boom.cylinder" = {{ field = "draw_wire_1", unit = "mm" }}
"""


@click.command()
@click.argument("directory", metavar="DIR", type=click.Path(file_okay=False, path_type=Path))
@click.option("--name", default=None, help="Name of the machine; the folder's name if left out.")
@json_option
def init(directory: Path, name: str | None, json_file: str | None) -> None:
    """Create the folders and templates for a machine in DIR. Existing files are not changed."""
    name = name or _name_of(directory)
    if not re.fullmatch(r"[a-z0-9][a-z0-9_-]*", name):
        raise SettingsError("--name", f"{name!r}", "lower-case letters, digits, '-' and '_'")
    files = {f"{folder}/README.md": f"# {folder}/\n\n{text}\n" for folder, text in FOLDERS.items()}
    files[f"datasets/{name}/machine.toml"] = MACHINE.format(name=name)
    files[f"datasets/{name}/recipe.toml"] = RECIPE.format(name=name)
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
    out = Printer(json_file)
    for relative in made:
        out.line(f"made  {directory / relative}")
    for relative in kept:
        out.line(f"kept  {directory / relative}")
    folder = directory / "datasets" / name
    out.line(f"Next: describe the machine in {folder / 'machine.toml'}, put logs into {folder / 'logs'}/<recording>/, then")
    out.line(f"      {command('ingest', folder)}")
    write_json(json_file, {"schema": 1, "directory": directory, "name": name, "made": made, "kept": kept})


def _name_of(directory: Path) -> str:
    """The name of a folder's machine; where an earlier version has made one with another name, that one."""
    text = directory.resolve().name
    before = re.sub(r"[^a-z0-9_-]+", "-", text.lower()).strip("-") or "machine"
    return before if (directory / "datasets" / before / "machine.toml").is_file() else slug(text, "machine")
