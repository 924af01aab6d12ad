"""``python -m sysid.bench RECIPE.toml OUT``: simulate the recordings of a bench recipe and write their logs."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from sysid.bench.recipe_file import load_recipe
from sysid.bench.write import write_all
from sysid.errors import SysidError


def main(arguments: list[str] | None = None) -> int:
    """Exit status: 0 when every log was written, 2 on a mistake in the recipe."""
    parser = argparse.ArgumentParser(prog="python -m sysid.bench", description="Logs of the stand-in machine.")
    parser.add_argument("recipe", type=Path, help="bench recipe (TOML)")
    parser.add_argument("out", type=Path, help="folder to write the recordings into")
    options = parser.parse_args(arguments)
    try:
        written = write_all(load_recipe(options.recipe), options.out)
    except SysidError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    for path in written:
        sys.stdout.write(f"{path}\t{path.stat().st_size}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
