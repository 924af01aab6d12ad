"""``python -m simulated_bench RECIPE.toml OUT``: simulate the recordings of a bench recipe and write their logs.

``python -m simulated_bench case CASE.toml OUT``: a sealed case, what a site hands over in ``OUT/site``, the truth in
``OUT/truth``.

``python -m simulated_bench live MACHINE.toml …``: the machine in real time on a serial line (:mod:`simulated_bench.live`).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from simulated_bench.case import load_case, write_case
from simulated_bench.joint_machines import load_joint_machine, write_joint_machine
from simulated_bench.recipe_file import load_recipe
from simulated_bench.write import write_all
from sysid.config import read_toml
from sysid.errors import SysidError


def main(arguments: list[str] | None = None) -> int:
    """Exit status: 0 when every log was written, 2 on a mistake in the recipe."""
    given = sys.argv[1:] if arguments is None else arguments
    if given[:1] == ["case"]:
        return _case(given[1:])
    if given[:1] == ["live"]:
        from simulated_bench.live import main as live

        return live(given[1:])
    parser = argparse.ArgumentParser(prog="python -m simulated_bench", description="Logs of the simulated test bench.")
    parser.add_argument("recipe", type=Path, help="bench recipe (TOML)")
    parser.add_argument("out", type=Path, help="folder to write the recordings into")
    options = parser.parse_args(given)
    try:
        if "kind" in read_toml(options.recipe):
            written = write_joint_machine(load_joint_machine(options.recipe), options.out)
        else:
            written = write_all(load_recipe(options.recipe), options.out)
    except SysidError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    for path in written:
        sys.stdout.write(f"{path}\t{path.stat().st_size}\n")
    return 0


def _case(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m simulated_bench case", description="A sealed case of the simulated test bench."
    )
    parser.add_argument("case", type=Path, help="case (TOML)")
    parser.add_argument("out", type=Path, help="folder to write site/ and truth/ into")
    options = parser.parse_args(arguments)
    try:
        write_case(load_case(options.case), options.out)
    except SysidError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write(f"{options.out / 'site'}\n{options.out / 'truth'}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
