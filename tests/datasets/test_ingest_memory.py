"""What an ingest holds lies in scratch files: the same version comes out, and the memory does not grow with the log."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from short_logs import shortened

from sysid.datasets import Store, ingest
from sysid.errors import StorageError

AUTOLOG = Path(__file__).parents[2] / "datasets/autolog"
#: Arrays come back from them in scratch files.
READS_IN_PROCESSES = True
#: What an ingest may take of memory [B], where twice the largest signal is less.
BOUND = 500e6


def content(workspace: Path) -> list[Any]:
    """Addresses of all tables, and everything that is said of a version."""
    manifest = Store(workspace).manifest("autolog")
    tables = [part[which]["files"] for part in manifest["parts"] for which in ("samples", "channels")]
    return [manifest["digest"], tables, manifest["quality"], manifest["clocks"], manifest["splits"]]


def test_the_same_version_comes_out_of_memory_and_of_scratch_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logs = shortened(AUTOLOG, tmp_path / "logs", {"manual-01": 12.0, "manual-02": 12.0, "manual-06": 12.0, "poses": 200.0})
    ingest(logs, tmp_path / "memory")
    monkeypatch.setattr("sysid.scratch.FREE", 0)
    monkeypatch.setattr("sysid.scratch.SMALLEST", 1)
    monkeypatch.setattr("sysid.scratch.PIECE", 1000)
    dataset = ingest(logs, tmp_path / "scratch")
    assert json.dumps(content(tmp_path / "scratch")) == json.dumps(content(tmp_path / "memory"))
    maps = Path("/proc/self/maps").read_text().splitlines()
    address = dataset.recordings[0].values("time").__array_interface__["data"][0]
    spans = [tuple(int(end, 16) for end in line.split()[0].split("-")) for line in maps if "(deleted)" in line]
    assert any(first <= address < last for first, last in spans)
    assert sorted(path.name for path in (tmp_path / "scratch").iterdir()) == ["datasets"]


def test_a_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_room(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("sysid.scratch.FREE", 2**20)
    monkeypatch.setattr("os.posix_fallocate", no_room)
    with pytest.raises(StorageError, match="no room for scratch files"):
        ingest(AUTOLOG, tmp_path / "ws")
    assert list(tmp_path.rglob("*")) == []


def write_log(folder: Path, size: float) -> None:
    """Three hours and more of a crane at 200 Hz, ``size`` bytes of text."""
    names = ["slew.command", "boom.command", "stick.command", "telescope.command", "slew.joint", "boom.joint", "boom.cylinder"]
    names += ["stick.joint", "stick.cylinder", "telescope.joint", "ee.x"]
    (folder / "long").mkdir(parents=True)
    rng, first, rows = np.random.default_rng(3), 0, 20_000
    with (folder / "long/log.csv").open("w") as file:
        file.write(",".join(["time", *names]) + "\n")
        while file.tell() < size:
            time_s = (first + np.arange(rows)) / 200.0
            first += rows
            columns = [np.sin((0.2 + 0.07 * k) * time_s + k) * np.sin(0.013 * time_s) for k in range(len(names))]
            columns = [values + 1e-4 * (k > 3) * rng.standard_normal(rows) for k, values in enumerate(columns)]
            row = ",".join(["%.3f"] + ["%.3f" if name.endswith("command") else "%.5f" for name in names]) + "\n"
            file.write("".join(row % cells for cells in zip(*(c.tolist() for c in (time_s, *columns)), strict=True)))


#: The most that a verb may take for each byte of the table (time and signals), above the process that has only started.
TIMES = 3.0
#: As the command line, and the most memory that the process has had so far [B].
VERB = (
    "import atexit, re, sys\nfrom sysid.cli import main\n"
    "atexit.register(lambda: print(1024 * int(re.search('VmHWM:\\\\s+(\\\\d+)', open('/proc/self/status').read())[1])))\n"
    "main(sys.argv[1:])"
)

CODE = "import sys, json; from sysid.datasets import ingest\nsaid = []\n" + (
    "ingest([sys.argv[1]], sys.argv[2], machine=sys.argv[3], progress=lambda done, text: said.append(done))\n"
    "print(json.dumps(said))"
)


def anonymous(process: int) -> int:
    """Memory of a process and of those it has started that the system cannot take back [B]."""
    total = 0
    try:
        tasks = [task / "children" for task in Path(f"/proc/{process}/task").iterdir()]
        children = [int(child) for task in tasks for child in task.read_text().split()]
        for line in Path(f"/proc/{process}/status").read_text().splitlines():
            total += 1024 * int(line.split()[1]) if line.startswith("RssAnon:") else 0
    except (FileNotFoundError, ProcessLookupError):
        return 0
    return total + sum(map(anonymous, children))


@pytest.mark.slow
def test_memory_of_a_long_log(tmp_path: Path) -> None:
    write_log(tmp_path / "logs", 300e6)
    argv = [sys.executable, "-c", CODE, str(tmp_path / "logs"), str(tmp_path / "ws"), str(AUTOLOG / "machine.toml")]
    most = 0
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as process:
        while process.poll() is None:
            most = max(most, anonymous(process.pid))
            time.sleep(0.05)
        assert process.stdout is not None
        said = json.loads(process.stdout.read())
    assert process.returncode == 0
    assert said == sorted(said)
    assert 50e6 < most < BOUND


@pytest.mark.slow
def test_memory_of_ten_hours_at_a_kilohertz(tmp_path: Path) -> None:
    """Command and joint, 36 million rows: ingest, quality and view."""
    rows, rng = 36_000_000, np.random.default_rng(1)
    times = np.arange(rows) / 1000.0
    there = rng.choice([-1.0, -0.4, 0.0, 0.0, 0.4, 1.0], (rows // 100_000, 25))
    command = np.repeat(np.hstack([there, -there]).ravel(), 2000)  # and back, so that it stays within the limits
    joint = np.cumsum(0.2e-3 * command) + rng.normal(0.0, 1e-4, rows)
    (tmp_path / "logs").mkdir()
    columns = {"time": times, "boom.command": command, "boom.joint": joint}
    pq.write_table(pa.table(columns), tmp_path / "logs/drive.parquet")
    del columns, times, command, joint
    (tmp_path / "machine.toml").write_text(
        'schema = 1\nname = "boom"\nrate_hz = 1000.0\n[[axes]]\nname = "boom"\nactuation = "velocity"\ndrives = "joint"\n'
        "gain = 0.2\nlimits = [-12.0, 12.0]\n"
    )

    def peak(*arguments: str) -> float:
        argv = [sys.executable, "-c", VERB, "--workspace", str(tmp_path / "ws"), *arguments]
        return float(subprocess.run(argv, capture_output=True, text=True, check=True).stdout.splitlines()[-1])

    started = peak("datasets")
    taken = {
        "ingest": peak("ingest", str(tmp_path / "logs"), "--machine", str(tmp_path / "machine.toml")),
        "quality": peak("datasets", "boom", "--quality"),
        "view": peak("view", "boom"),
    }
    over = {verb: (most - started) / (3 * 8 * rows) for verb, most in taken.items()}
    assert max(over.values()) < TIMES, over
