"""Each verb killed before each thing that it changes on the disk: the state before or after is seen, and the rerun succeeds."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from killed import dies_at, full_from, steps_of
from verbs import VERBS, State, Verb, seen

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")

BY_NAME = {verb.name: verb for verb in VERBS}


class Bench:
    """A verb's workspace as it begins, what is seen of it before and after, and copies of it to kill in."""

    def __init__(self, verb: Verb, root: Path) -> None:
        self.verb, self.root = verb, root
        (root / "begin").mkdir(parents=True)
        verb.prepare(root / "begin" / "ws")
        self.before = seen(self.fresh("before"))
        whole = self.fresh("whole")
        self.steps = steps_of(verb.work, whole)
        self.after = seen(whole)

    def fresh(self, name: str) -> Path:
        """A copy of the beginning; its name does not depend on the step, so that paths in files are the same."""
        place = self.root / name
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(self.root / "begin", place)
        return place / "ws"


@pytest.fixture(scope="module")
def benches(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Bench]:
    return {}


@pytest.fixture
def bench(request: pytest.FixtureRequest, benches: dict[str, Bench], tmp_path_factory: pytest.TempPathFactory) -> Bench:
    name = request.param
    if name not in benches:
        benches[name] = Bench(BY_NAME[name], tmp_path_factory.mktemp("faults"))
    return benches[name]


def sampled(steps: int) -> set[int]:
    """Steps of the quick tier: in the middle and the last; the slow tier takes all."""
    return {1 + steps // 2, steps}


def check(bench: Bench, workspace: Path, state: State, step: int) -> None:
    """What a fault at ``step`` left, and what the same command makes of it."""
    allowed = [bench.before, bench.after]
    assert bench.verb.between or state in allowed, f"step {step} of {bench.steps}: {state}"
    bench.verb.work(workspace)
    assert seen(workspace) == bench.after, f"rerun after step {step} of {bench.steps}"
    left = [path.name for path in workspace.rglob("*") if path.name.endswith(".part") or ".partial-" in path.name]
    assert left == [], f"rerun after step {step} of {bench.steps}"


def kill(bench: Bench, step: int) -> None:
    workspace = bench.fresh("killed")
    died, state = dies_at(step, bench.verb.work, workspace), seen(workspace)
    # Training writes by threads: it may take a step less.
    assert died or (state == bench.after and step > 0.9 * bench.steps), f"step {step} of {bench.steps} was not reached"
    check(bench, workspace, state, step)


#: Interrupted trainings are in networks/ and rl/, a watch that is killed at each write in fleet/test_watch_arrivals.py.
QUICK = [name for name in BY_NAME if name not in ("fit", "train", "fleet watch")]


@pytest.mark.parametrize("bench", QUICK, indirect=True)
def test_kills_at_some_steps(bench: Bench) -> None:
    assert bench.before != bench.after
    for step in sampled(bench.steps):
        kill(bench, step)


@pytest.mark.slow
@pytest.mark.parametrize("bench", BY_NAME, indirect=True)
def test_kills_at_every_step(bench: Bench) -> None:
    for step in range(1, bench.steps + 1):
        kill(bench, step)


def fill(bench: Bench, step: int) -> None:
    workspace = bench.fresh("full")
    assert full_from(step, bench.verb.work, workspace) in (0, 2), f"step {step} of {bench.steps}: no error of the toolkit"
    check(bench, workspace, seen(workspace), step)


@pytest.mark.parametrize("bench", ["append", "register"], indirect=True)
def test_a_disk_that_is_full_from_some_step_on(bench: Bench) -> None:
    for step in sampled(bench.steps):
        fill(bench, step)


@pytest.mark.slow
@pytest.mark.parametrize("bench", BY_NAME, indirect=True)
def test_a_disk_that_is_full_from_any_step_on(bench: Bench) -> None:
    for step in range(1, bench.steps + 1):
        fill(bench, step)


#: What changes a file or its name, as the kernel sees it: sqlite makes its calls itself.
CALLS = "fsync,fdatasync,pwrite64,ftruncate,unlink,unlinkat,rename,renameat,renameat2,link,linkat,mkdir,rmdir"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("strace") is None, reason="needs strace")
@pytest.mark.parametrize("bench", ["register, first of a workspace", "register", "promote", "repair"], indirect=True)
def test_kills_at_every_call_of_the_kernel(bench: Bench, tmp_path: Path) -> None:
    """Also within a commit of sqlite."""
    work = bench.verb.work.__name__
    code = f"import sys; from pathlib import Path; from registry_verbs import {work}; {work}(Path(sys.argv[1]))"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "PYTHONDONTWRITEBYTECODE": "1"}

    def run(workspace: Path, *options: str) -> int:
        command = [
            "strace",
            "-f",
            "-qq",
            "--seccomp-bpf",
            "-o",
            str(tmp_path / "calls"),
            *options,
            sys.executable,
            "-c",
            code,
            str(workspace),
        ]
        return subprocess.run(command, env=environment, check=False).returncode

    assert run(bench.fresh("whole"), "-e", f"trace={CALLS}") == 0
    made: Counter[str] = Counter()
    for line in (tmp_path / "calls").read_text().splitlines():
        call = line.split(maxsplit=1)[1].partition("(")[0]
        made[call] += 1  # strace counts each call by itself
        workspace = bench.fresh("killed")
        assert run(workspace, "-e", f"inject={call}:signal=KILL:when={made[call]}") != 0
        check(bench, workspace, seen(workspace), made.total())
    assert made["fsync"] + made["fdatasync"] >= 3
