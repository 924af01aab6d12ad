"""When does a network pay? Held-out errors over the amount of data: physical model, residual network, networks alone.

    .venv/bin/python pipelines/network_pays.py DATA --work WORK [--only TITLE …] [--publish]

DATA holds the raw files of the measured sets (``hyd_actuator``, ``emps``, ``rc_excavator``, ``sage_so101``; the README.md of
each in ``datasets/`` has their source). A set that is not there is left out; its figures stay as in the committed result.
Every case (machine, length, model) is a file in WORK, and is not run again. Parts are in ``pipelines/pays/``.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from committed import provenance, write_result, write_tables
from pays.machines import BENCH, MEASURED, ROOT, Source, bench_source, evaluated_rows, measured_source, seconds_of
from pays.models import SEEDS, motion_row, plant_rows, recurrent_row
from pays.page import figure, tables
from sysid.cli.output import Printer

Row = dict[str, Any]
PIPELINE = "pipelines/network_pays.py"
FOLDER = ROOT / "reports" / "network_pays"
#: The machine whose rate and history are varied; steps [s], and spans of the history of commands and speeds [s].
VARIED, STEPS, SPANS = "EMPS", (0.01, 0.02, 0.05, 0.1), (0.1, 0.2, 0.4, 0.8)


def main(raw: Path, work: Path, only: tuple[str, ...] = ()) -> Row:
    """Run what WORK does not have, and return the result."""
    out = Printer()
    (work / "cases").mkdir(parents=True, exist_ok=True)
    before = json.loads((FOLDER / "result.json").read_text("utf-8")) if (FOLDER / "result.json").exists() else {}
    found: Row = {"machines": dict(before.get("machines", {})), "rate_and_history": before.get("rate_and_history", [])}
    for title, made in sources(raw, work):
        if only and title not in only:
            continue
        if made is None:
            out.line(f"{title}: left out, its files are not in {raw}")
            continue
        source = made()
        found["machines"][title] = machine_row(source, work, out)
        if title == VARIED:
            found["rate_and_history"] = list(varied(source, work, out))
    return found


def sources(raw: Path, work: Path) -> Iterator[tuple[str, Callable[[], Source] | None]]:
    """Title and recordings of every machine; None where its files are not there."""
    for item in MEASURED:
        yield item.title, partial(measured_source, item, raw, work) if (raw / item.folder).is_dir() else None
    for title in BENCH:
        yield title, partial(bench_source, title)


def machine_row(source: Source, work: Path, out: Printer) -> Row:
    """All lengths of one machine."""
    moved = [r.values(source.signal)[evaluated_rows(r, source.command, source.signal)] for r in source.test]
    row: Row = {
        "signal": source.signal,
        "unit": source.unit,
        "deviation": float(np.std(np.concatenate(moved))),
        "test_seconds": seconds_of(source.test),
        "lengths": [],
    }
    for seconds in reversed(source.lengths):  # the most telling one first
        models = {
            "plant": partial(plant_rows, source, seconds),
            "motion": partial(motion_row, source, seconds),
            "recurrent": partial(recurrent_row, source, seconds),
        }
        entry: Row = {"seconds": seconds, "cpu_seconds": 0.0}
        for name, make in models.items():
            spent = entry["cpu_seconds"]
            entry |= kept(work, f"{source.title} {seconds:.1f} {name}", make, out)
            entry["cpu_seconds"] += spent
        row["lengths"].insert(0, entry)
    return row


def varied(source: Source, work: Path, out: Printer) -> Iterator[Row]:
    """Errors of motion networks of all data with other steps and histories, of one member each."""
    for step in STEPS:
        for span in SPANS:
            grid = [float(t) for t in np.arange(0.0, span + 1e-9, step)]
            recipe = {"members": 1, "step": step, "history": grid, "speeds": grid[1:4]}
            make = partial(motion_row, source, source.lengths[-1], recipe)
            yield {"step": step, "span": span, **kept(work, f"{source.title} step {step} span {span}", make, out)}


def kept(work: Path, name: str, make: Callable[[], Row], out: Printer) -> Row:
    """The figures of a case from its file, which is made if it is missing."""
    path = work / "cases" / f"{name.replace(',', '').replace(' ', '-')}.json"
    if not path.exists():
        begin = time.process_time()
        content = {**make(), "cpu_seconds": time.process_time() - begin}
        path.write_text(json.dumps(content, allow_nan=False), "utf-8")
        out.line(f"{name}: {content['cpu_seconds']:.0f} s of processor time")
    found: Row = json.loads(path.read_text("utf-8"))
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raw", type=Path, help="folder of the measured sets")
    parser.add_argument("--work", type=Path, required=True, help="folder of the cases")
    parser.add_argument("--only", nargs="*", default=(), metavar="TITLE", help="these machines")
    parser.add_argument("--publish", action="store_true", help="write reports/network_pays/")
    given = parser.parse_args()
    made = main(given.raw, given.work, tuple(given.only))
    print(tables(made))
    if given.publish:
        head = provenance("python pipelines/network_pays.py DATA --work WORK --publish", SEEDS[0], ("torch",))
        write_result(FOLDER / "result.json", {**head, **made})
        write_tables(FOLDER / "README.md", tables(made), PIPELINE)
        (FOLDER / "errors.svg").write_text(figure(made), "utf-8")
