"""Runs cases in separate processes; a case that has an answer is not run again."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.forkserver import ensure_running
from pathlib import Path

from hidden.cases import CaseSpec
from hidden.make import make_case
from hidden.reach import reach
from hidden.solve import solve

#: Longest processor time for making a case and for answering it [s]; an answer that takes longer is a failure. Each process
#: has one thread, so that the time hardly depends on the load of the computer.
MAKING, ANSWERING = 300.0, 180.0
#: Longest wall time, in longest processor times.
PATIENCE = 6.0
#: Each process computes on one thread; cases run side by side instead.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
#: Each step of each case is a process, forked from one that has only imported the modules.
_FRESH = multiprocessing.get_context("forkserver")
_FRESH.set_forkserver_preload(["hidden.make", "hidden.solve", "hidden.reach"])
_STARTING = threading.Lock()


@dataclass(frozen=True)
class Place:
    """Folders of one calibration, those of one seed: made cases, their sealed truth, and the answers."""

    work: Path

    @property
    def nominal(self) -> Path:
        """The owners' fitted plants: those of the machines, whatever the seed."""
        return self.work.parent / "nominal"

    def site(self, spec: CaseSpec) -> Path:
        return self.work / "cases" / spec.name / "site"

    def sealed(self, spec: CaseSpec) -> Path:
        return self.work / "sealed" / f"{spec.name}.json"

    def answer(self, spec: CaseSpec) -> Path:
        return self.work / "answers" / f"{spec.name}.json"

    def reach(self, spec: CaseSpec) -> Path:
        """Errors of the true plant."""
        return self.work / "reach" / f"{spec.name}.json"


def run_all(
    specs: Sequence[CaseSpec],
    work: Path,
    workers: int,
    keep: bool,
    tell: Callable[[str], None],
    limit: float = ANSWERING,
    make: Callable[..., object] = make_case,
) -> None:
    """Make and answer every case that has no answer yet.

    Args:
        make: of the bench; called with a case, the folder, and where owners' fitted plants are kept.
    """
    place = Place(work)
    waiting = [spec for spec in specs if not place.answer(spec).exists()]

    def one(spec: CaseSpec) -> None:
        begin = time.perf_counter()
        failure = make_and_answer(spec, place, limit, make)
        if not keep:
            shutil.rmtree(place.site(spec).parent, ignore_errors=True)
        tell(f"{spec.name:12s} {time.perf_counter() - begin:6.1f} s{'  ' + failure if failure else ''}")

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(one, waiting))


def make_and_answer(spec: CaseSpec, place: Place, limit: float, make: Callable[..., object] = make_case) -> str | None:
    """Write an answer, or the failure; returns the failure, or None."""
    place.answer(spec).parent.mkdir(parents=True, exist_ok=True)
    made = run_process(make, [spec, place.work, place.nominal], MAKING)
    failure = f"not made: {made}" if made else None
    if failure is None:
        # This process does not get the folder with the truth.
        failed = run_process(solve, [place.site(spec), place.answer(spec)], limit)
        failure = f"not answered: {failed}" if failed else None
    if failure is None and spec.hidden and spec.group != "unknown":
        place.reach(spec).parent.mkdir(parents=True, exist_ok=True)
        # Without a plant for the truth there is no limit to compare with.
        run_process(reach, [place.site(spec), place.sealed(spec), place.reach(spec)], limit)
    if failure is not None:
        place.answer(spec).write_text(json.dumps({"failure": failure}) + "\n", "utf-8")
    return failure


def run_process(task: Callable[..., object], arguments: Sequence[object], limit: float) -> str | None:
    """Call a function in a separate process; returns the error, or None.

    Args:
        limit: of its processor time [s].
    """
    ours, theirs = _FRESH.Pipe(duplex=False)
    process = _FRESH.Process(target=_limited, args=(task, arguments, limit, theirs), daemon=True)
    with _STARTING:
        _ensure_ancestor()
        process.start()
    theirs.close()
    process.join(PATIENCE * limit)
    if process.is_alive():
        process.kill()
        process.join()
        return f"took more than {PATIENCE * limit:.0f} s of wall time"
    if process.exitcode == -signal.SIGXCPU:
        return f"took more than {limit:.0f} s"
    if process.exitcode != 0:
        return ours.recv() if ours.poll() else f"exit status {process.exitcode}"
    return None


def _ensure_ancestor() -> None:
    """Start the process that the others are forked from, with its environment and not this one's."""
    before = dict(os.environ)
    here = Path(__file__).resolve().parents[1]
    os.environ.update(ONE_THREAD, PYTHONPATH=os.pathsep.join((str(here), str(here.parent))))
    try:
        ensure_running()
    finally:
        os.environ.clear()
        os.environ.update(before)


def _limited(task: Callable[..., object], arguments: Sequence[object], limit: float, report: Connection) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(limit), math.ceil(limit) + 5))
    try:
        task(*arguments)
    except Exception as error:
        report.send(f"{type(error).__module__}.{type(error).__name__}: {error}".splitlines()[0][:300])
        sys.exit(1)
