"""``sysid demo``: runs ``pipelines/first_look.py`` of the project."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import click

from sysid.cli.output import json_option

PIPELINE = Path("pipelines") / "first_look.py"


@click.command()
@json_option
@click.pass_obj
def demo(workspace: str, json_file: str | None) -> None:
    """Run the whole line on the logs that ship: datasets/autolog."""
    import shutil

    module = _load(_find())
    result = module.main(Path(workspace))
    if json_file is not None and json_file != "-":
        shutil.copyfile(result, json_file)
    elif json_file == "-":
        click.echo(Path(result).read_text("utf-8"), nl=False)


def _find() -> Path:
    """The pipeline of the folder we are in, of one above it, or of the checkout that the package runs from.

    Raises:
        SettingsError: none of them has one.
    """
    from sysid.errors import SettingsError

    here = Path.cwd()
    for folder in (here, *here.parents, Path(__file__).resolve().parents[2]):
        if (folder / PIPELINE).is_file():
            return folder / PIPELINE
    raise SettingsError("demo", f"no {PIPELINE} here or above", "the project's own folder", "Run it in a checkout.")


def _load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("first_look", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
