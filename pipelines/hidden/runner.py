"""Runs cases one by one in processes of their own; a case that has an answer is not run again."""

from __future__ import annotations

import json
import math
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from hidden.cases import CaseSpec

#: Longest processor time for making a case and for answering it [s]; an answer that takes longer is a failure. Each process
#: computes on one thread, so that this is the time on a quiet machine, whatever else this one does.
MAKING, ANSWERING = 300.0, 180.0
#: Longest wall time, in longest processor times.
PATIENCE = 6.0
#: Each process computes on one thread; cases run side by side instead.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


@dataclass(frozen=True)
class Place:
    """Folders of one calibration: made cases, their sealed truth, and the answers."""

    work: Path

    def site(self, spec: CaseSpec) -> Path:
        return self.work / "cases" / spec.name / "site"

    def sealed(self, spec: CaseSpec) -> Path:
        return self.work / "sealed" / f"{spec.name}.json"

    def answer(self, spec: CaseSpec) -> Path:
        return self.work / "answers" / f"{spec.name}.json"

    def reach(self, spec: CaseSpec) -> Path:
        """What the true plant scores."""
        return self.work / "reach" / f"{spec.name}.json"

    def keep_spec(self, spec: CaseSpec) -> Path:
        path = self.work / "specs" / f"{spec.name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(spec.to_json()), "utf-8")
        return path


def run_all(
    specs: Sequence[CaseSpec], work: Path, workers: int, keep: bool, tell: Callable[[str], None], limit: float = ANSWERING
) -> None:
    """Make and answer every case that has no answer yet."""
    place = Place(work)
    place.answer(specs[0]).parent.mkdir(parents=True, exist_ok=True)
    waiting = [spec for spec in specs if not place.answer(spec).exists()]

    def one(spec: CaseSpec) -> None:
        begin = time.perf_counter()
        failure = make_and_answer(spec, place, limit)
        if not keep:
            shutil.rmtree(place.site(spec).parent, ignore_errors=True)
        tell(f"{spec.name:12s} {time.perf_counter() - begin:6.1f} s{'  ' + failure if failure else ''}")

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(one, waiting))


def make_and_answer(spec: CaseSpec, place: Place, limit: float) -> str | None:
    """Leave an answer, which may be that there is none; returns why, if so."""
    made = run_process("hidden.make", [str(place.keep_spec(spec)), str(place.work)], MAKING)
    failure = f"not made: {made}" if made else None
    if failure is None:
        # The folder with the truth is not among what this process is told of.
        failed = run_process("hidden.solve", [str(place.site(spec)), str(place.answer(spec))], limit)
        failure = f"not answered: {failed}" if failed else None
    if failure is None and spec.hidden and spec.group != "unknown":
        place.reach(spec).parent.mkdir(parents=True, exist_ok=True)
        # A truth that the plant cannot take leaves nothing to compare with.
        run_process("hidden.reach", [str(place.site(spec)), str(place.sealed(spec)), str(place.reach(spec))], limit)
    if failure is not None:
        place.answer(spec).write_text(json.dumps({"failure": failure}) + "\n", "utf-8")
    return failure


def run_process(module: str, arguments: list[str], limit: float) -> str | None:
    """Run a module of this package; what went wrong, if anything did."""
    here = Path(__file__).resolve().parents[1]
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join((str(here), str(here.parent)))}
    command = [sys.executable, "-m", module, *arguments]
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=PATIENCE * limit, check=False,
            preexec_fn=partial(resource.setrlimit, resource.RLIMIT_CPU, (math.ceil(limit), math.ceil(limit) + 5)),
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"took more than {PATIENCE * limit:.0f} s of wall time"
    if done.returncode == -signal.SIGXCPU:
        return f"took more than {limit:.0f} s"
    if done.returncode != 0:
        last = done.stderr.strip().splitlines()[-1:] or [f"exit status {done.returncode}"]
        return last[0][:300]
    return None
