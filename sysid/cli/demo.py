"""``sysid demo``: runs ``pipelines/first_look.py`` of the checkout that this package is installed from, else of the wheel."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import click

from sysid.cli.output import json_option, write_json_text

PIPELINE = "pipelines/first_look.py"


@click.command()
@json_option
@click.pass_obj
def demo(workspace: str, json_file: str | None) -> None:
    """Run the whole workflow on the shipped logs of a hydraulic crane.

    Networks are fitted where torch is installed, and a Rerun recording is written where rerun-sdk is.
    """
    from sysid.front import shipped

    module = _load(shipped.shipped_file(PIPELINE, shipped.CHECKOUT, shipped.SHIPPED))
    result: Path = module.main(Path(workspace))
    write_json_text(json_file, result.read_text("utf-8"))


def _load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("first_look", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
