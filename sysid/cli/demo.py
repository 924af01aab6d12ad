"""``sysid demo``: runs a pipeline of the checkout that this package is installed from, else of the wheel."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import click

from sysid.cli.output import Printer, json_option, write_json_text
from sysid.errors import SettingsError

PIPELINE, ARM = "pipelines/first_look.py", "pipelines/demo_arm.py"


@click.command()
@click.option("--arm", is_flag=True, help="An electric arm instead, made wrong in MuJoCo in three ways.")
@click.option(
    "--hide",
    multiple=True,
    metavar="KIND:JOINT=VALUE",
    help="With --arm: hide this instead, as friction:joint2=6, mass:joint4=1.5 (times the model's); may be repeated.",
)
@json_option
@click.pass_obj
def demo(workspace: str, arm: bool, hide: tuple[str, ...], out: Printer) -> None:
    """Run the whole workflow on the shipped logs of a hydraulic crane, or on logs of a simulated arm.

    Networks are fitted where torch is installed, and a Rerun recording is written where rerun-sdk is. --arm needs the packages
    mujoco-core and pybullet.
    """
    from sysid.front import shipped

    if hide and not arm:
        raise SettingsError("sysid demo", "--hide without --arm", "both, or neither", "Add --arm.")
    module = _load(shipped.shipped_file(ARM if arm else PIPELINE, shipped.CHECKOUT, shipped.SHIPPED))
    result: Path = module.main(Path(workspace), hide or module.HIDDEN) if arm else module.main(Path(workspace))
    write_json_text(out.json_file, result.read_text("utf-8"))


def _load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # dataclasses look their module up there
    spec.loader.exec_module(module)
    return module
