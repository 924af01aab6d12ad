"""``sysid demo``: runs ``pipelines/first_look.py`` of the checkout that this package is installed from, else of the wheel."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import click

from sysid.cli.output import json_option, write_json_text

#: The root of a checkout, and the part of a wheel that holds the same files: the pipeline and its logs.
CHECKOUT = Path(__file__).resolve().parents[2]
SHIPPED = Path(__file__).resolve().parents[1] / "shipped"
PIPELINE = "pipelines/first_look.py"


@click.command()
@json_option
@click.pass_obj
def demo(workspace: str, json_file: str | None) -> None:
    """Run the whole workflow on the shipped logs of a hydraulic crane.

    Networks are fitted where torch is installed, and a Rerun recording is written where rerun-sdk is.
    """
    module = _load(find_pipeline(CHECKOUT, SHIPPED))
    result: Path = module.main(Path(workspace))
    write_json_text(json_file, result.read_text("utf-8"))


def find_pipeline(checkout: Path, shipped: Path) -> Path:
    """The pipeline of a checkout, else of the wheel.

    Raises:
        SettingsError: neither is there.
    """
    from sysid.errors import SettingsError

    # The folder of installed packages may contain another package named `pipelines`.
    if (checkout / "pyproject.toml").is_file() and (checkout / PIPELINE).is_file():
        return checkout / PIPELINE
    if (shipped / PIPELINE).is_file():
        return shipped / PIPELINE
    remedy = "Install the wheel again, or clone the repository and type `make demo`."
    raise SettingsError("sysid demo", f"no {PIPELINE} in {checkout} or {shipped}", "the files of the wheel", remedy)


def _load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("first_look", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
