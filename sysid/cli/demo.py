"""``sysid demo``: runs ``pipelines/first_look.py`` of the checkout that this package is installed from."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import click

from sysid.cli.output import json_option, write_json_text

#: The pipeline and its logs are content of the repository, not of the package.
CHECKOUT = Path(__file__).resolve().parents[2]
PIPELINE = "pipelines/first_look.py"


@click.command()
@json_option
@click.pass_obj
def demo(workspace: str, json_file: str | None) -> None:
    """Run the whole workflow on the shipped logs in datasets/autolog."""
    module = _load(find_pipeline(CHECKOUT))
    result: Path = module.main(Path(workspace))
    write_json_text(json_file, result.read_text("utf-8"))


def find_pipeline(checkout: Path) -> Path:
    """The pipeline of a checkout.

    Raises:
        SettingsError: the package is not installed from a checkout.
    """
    from sysid.errors import SettingsError

    path = checkout / PIPELINE
    # The folder of installed packages may contain another package named `pipelines`.
    if not path.is_file() or not (checkout / "pyproject.toml").is_file():
        remedy = "Clone the repository and type `make demo`; run your own pipeline with `python FILE`."
        raise SettingsError("sysid demo", f"no {PIPELINE} in {checkout}", "sysid to be installed from its repository", remedy)
    return path


def _load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("first_look", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
