"""Makes and answers the cases of rows and seeds in processes of their own; a case that has an answer is not run again.

<work>/<row>/<case>/site, truth.json, clean    removed after the answer unless they are kept; truth.json stays
<work>/<row>/<case>/answer.json                what the workflow answered, or why there is no answer, and the commit of its code
"""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from arms.case import write_case
from arms.generate import ROWS, cases_of
from committed import commit_of

#: Longest wall time of an answer [s].
ANSWERING = 1800.0
#: One thread a case where several run side by side.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
PIPELINES = Path(__file__).resolve().parents[1]


def run_all(
    rows: Sequence[str], seeds: Sequence[int], work: Path, workers: int, keep: bool, report: Callable[[str], None]
) -> None:
    """Make and answer every case of ``rows`` and ``seeds`` that has no answer."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        waiting = {pool.submit(run_seed, row, seed, work, workers, keep): (row, seed) for seed in seeds for row in rows}
        for done in as_completed(waiting):
            for line in done.result():
                report(line)


def run_seed(row: str, seed: int, work: Path, workers: int, keep: bool) -> list[str]:
    """Make and answer the cases of one seed; returns a line for each."""
    marks = work / row / f"seed-{seed:03d}.done"
    if marks.exists():
        return []
    lines = []
    for case in cases_of(row, seed):
        folder = work / row / case.name
        site = write_case(case, folder)
        commit, out = commit_of(PIPELINES), folder / "answer.json"
        failure = answer(site, out, workers)
        _write(out, json.loads(out.read_text("utf-8")) | {"commit": commit})
        if not keep:
            shutil.rmtree(site)
            shutil.rmtree(folder / "clean")
        lines.append(f"{case.name:28s} {failure or 'answered'}")
    marks.write_text("\n".join(lines) + "\n", "utf-8")
    return lines


def answer(site: Path, out: Path, workers: int) -> str | None:
    """Run :mod:`arms.solve` on a site; returns the failure, or None."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(PIPELINES), str(PIPELINES.parent)))}
    if workers > 1:
        environment |= ONE_THREAD
    command = [sys.executable, "-m", "arms.solve", str(site), str(out)]
    try:
        done = subprocess.run(command, env=environment, timeout=ANSWERING, capture_output=True, text=True, check=False)
        failure = None if done.returncode == 0 else (done.stderr.strip().splitlines() or [f"exit {done.returncode}"])[-1]
    except subprocess.TimeoutExpired:
        failure = f"took more than {ANSWERING:.0f} s of wall time"
    if failure is not None:
        _write(out, {"failure": failure[:300]})
    return failure


def _write(out: Path, answered: dict[str, Any]) -> None:
    out.write_text(json.dumps(answered, indent=1) + "\n", "utf-8")


def folders(rows: Sequence[str], seeds: Sequence[int], work: Path) -> list[Path]:
    """The folders of all answered cases of ``rows`` and ``seeds``, in order."""
    wanted = {f"{row}-{seed:03d}" for row in rows for seed in seeds}
    found = [path.parent for row in ROWS if row in rows for path in sorted((work / row).glob("*/answer.json"))]
    return [folder for folder in found if "-".join(folder.name.split("-")[:2]) in wanted]


def commits_of(answered: Sequence[Path]) -> list[str]:
    """The commits whose code answered these cases, in order of appearance."""
    found = (json.loads((folder / "answer.json").read_text("utf-8")).get("commit") for folder in answered)
    return list(dict.fromkeys(commit for commit in found if commit))
