"""The goals of electric arms, servos, drives and static poses: simulated machines with known hidden effects, scored.

    python pipelines/electric_arms.py [--rows arm,poses] [--seeds 0:1] [--workers N] [--work FOLDER] [--keep]
    python pipelines/electric_arms.py --rows poses --seeds 120:129 --publish         (reports/electric_arms/)
    python pipelines/electric_arms.py --measured WORKSPACE --data DATA               (measured machines beside their base)

Every case is generated from its seed, written as logs with a machine description, and answered from these alone in a process
of its own; then it is compared with the truth. An interrupted run continues. Seeds 0 to 19 are for development; seeds 120 to
179 are published, and only the final run of a row uses them, ten of them at least. A row that is published replaces its earlier
cases; all others keep theirs.

``--measured`` reads the results that pipelines/emps.py, xl330.py, so101.py and ur10e.py left in a workspace, and calibrates
TIAGo and UR10 anew. A machine without a result there keeps its earlier figures.

Order of reading of arms/: case, motion, rigid; the rows arm, servo_arm, servo_sag, poses, flexible, smooth_friction; generate,
solve, runner, names, score, published, measured, page, goals.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from arms.generate import ROWS, generate
from arms.goals import goal_table
from arms.measured import compared, figures, merged_machines, names
from arms.page import measured_table, page_tables
from arms.published import check_published, merged, result_of
from arms.runner import commits_of, folders, run_all
from arms.score import score_case
from committed import provenance, write_result, write_tables

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "reports" / "electric_arms" / "README.md"
REPORTS = ROOT / "reports" / "electric_arms"


def seeds_of(text: str) -> list[int]:
    """``FIRST:LAST``, both included, or one number.

    Raises:
        ValueError: no whole numbers.
    """
    first, _, last = text.partition(":")
    if not first.isdecimal() or not (last or first).isdecimal():
        raise ValueError(f"--seeds {text!r}: expected FIRST:LAST, two whole numbers, for example 0:9")
    return list(range(int(first), int(last or first) + 1))


def rows_of(text: str) -> list[str]:
    """Names of rows, separated by commas.

    Raises:
        ValueError: a row that does not exist.
    """
    rows = text.split(",")
    unknown = [row for row in rows if row not in ROWS]
    if unknown:
        raise ValueError(f"--rows: unknown row {unknown[0]!r}; expected some of {', '.join(ROWS)}")
    return rows


def scored(rows: Sequence[str], seeds: Sequence[int], work: Path, command: str) -> dict[str, Any]:
    """The contents of a result file, from the cases that have an answer."""
    cases = [score_case(folder).to_json() for folder in folders(rows, seeds, work)]
    commits = {row: commits_of(folders([row], seeds, work)) for row in rows}
    return result_of(rows, seeds, cases, commits, provenance(command, None, ("mujoco-core",)))


def publish(result: dict[str, Any]) -> None:
    """Write the result beside the rows that were published before, and the tables of the page."""
    whole = merged(stored("result"), result)
    write_result(REPORTS / "result.json", whole)
    write_tables(PAGE, page_tables(whole, stored("before")), "pipelines/electric_arms.py")
    write_goals()


def stored(name: str) -> dict[str, Any] | None:
    """A committed result, or None."""
    path = REPORTS / f"{name}.json"
    found: dict[str, Any] | None = json.loads(path.read_text("utf-8")) if path.exists() else None
    return found


def write_goals() -> None:
    """The table of the goals, where the simulated and the measured machines have figures."""
    simulated, measured, before = (stored(name) for name in ("result", "measured", "measured_before"))
    if simulated and measured and before:
        changes = compared(before["figures"], measured["figures"])
        write_tables(PAGE, goal_table(simulated["cases"], measured, changes), "pipelines/electric_arms.py: goals")


def measure(workspace: Path, data: Path, base: bool) -> None:
    """Compare the measured machines with their base, or record the base."""
    found = {**provenance(f"python pipelines/electric_arms.py --measured {'--base' if base else ''}".rstrip(), None)}
    fresh = {"figures": figures(workspace, data), "named": names(workspace)}
    found |= fresh if base else merged_machines(stored("measured") or {}, fresh)
    write_result(REPORTS / ("measured_before.json" if base else "measured.json"), found)
    if not base:
        before = json.loads((REPORTS / "measured_before.json").read_text("utf-8"))
        table = measured_table(compared(before["figures"], found["figures"]))
        write_tables(PAGE, table, "pipelines/electric_arms.py --measured")
        write_goals()


def main(given: argparse.Namespace) -> None:
    if given.measured is not None:
        measure(given.measured, given.data, given.base)
        return
    rows, seeds = rows_of(given.rows), seeds_of(given.seeds)
    if given.publish:
        check_published(seeds, {})
    if given.generate:
        for folder in generate(rows, seeds, given.work):
            print(folder)
        return
    run_all(rows, seeds, given.work, given.workers, given.keep, lambda text: print(text, flush=True))
    command = f"python pipelines/electric_arms.py --rows {given.rows} --seeds {given.seeds}"
    result = scored(rows, seeds, given.work, command)
    write_result(given.work / "result.json", result)
    print(page_tables(result))
    if given.publish:
        check_published(seeds, {row: own["commits"] for row, own in result["rows"].items()})
        publish(result)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", default=",".join(ROWS), help="of the table, separated by commas")
    parser.add_argument("--seeds", default="0:1", help="FIRST:LAST, both included")
    parser.add_argument("--workers", type=int, default=1, help="cases side by side; with several, each has one thread")
    parser.add_argument("--work", type=Path, default=ROOT / "workspace" / "electric_arms", help="folder of cases and answers")
    parser.add_argument("--keep", action="store_true", help="keep the logs of the cases")
    parser.add_argument("--generate", action="store_true", help="write the cases and stop")
    parser.add_argument("--publish", action="store_true", help="write reports/electric_arms/result.json and the page's tables")
    parser.add_argument("--measured", type=Path, metavar="WORKSPACE", help="compare the measured machines instead")
    parser.add_argument(
        "--data",
        type=Path,
        default=ROOT / ".." / "shared" / "data",
        help="folder with tiago_mocap, or without it: no calibration",
    )
    parser.add_argument("--base", action="store_true", help="with --measured: record these figures as those before")
    try:
        main(parser.parse_args())
    except ValueError as error:
        parser.exit(2, f"{error}\n")
