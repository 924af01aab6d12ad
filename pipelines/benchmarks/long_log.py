"""One hour of an axis at 1 kHz: processor time and memory of the verbs that read a stored version."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.rows import against_limit
from sysid.datasets import ingest

HOURS, RATE = 1.0, 1000.0
#: A log of so many samples takes what the code and its libraries take.
SHORT = 60_000
#: Processor time of a verb [s], imports included; memory above that of the short log, in sizes of the two signals.
LIMIT_S, LIMIT_SIZES = 5.0, 1.25
VERBS = {"quality": ("datasets", "--quality"), "view": ("view",), "report": ("report",)}
#: As the command line; at its end processor time [s] and the most memory that the process has had [B].
CHILD = """import atexit, json, re, sys, time
from sysid.cli import main
status = lambda: open("/proc/self/status").read()
peak = lambda: 1024 * int(re.search(r"VmHWM:\\s+(\\d+)", status())[1])
atexit.register(lambda: print(json.dumps([time.process_time(), peak()])))
main(sys.argv[1:])"""
_MACHINE = """schema = 1
name = "slide"
rate_hz = 1000.0
[[axes]]
name = "slide"
actuation = "velocity"
drives = "joint"
joint_type = "prismatic"
gain = 0.1
limits = [-0.05, 0.35]
"""


def write_log(folder: Path, rows: int) -> int:
    """Moves of all sizes between rests, with the noise of an encoder; the size of the two signals [B]."""
    rng, command, place, at = np.random.default_rng(0), np.zeros(rows), 0.15, 0
    while (first := at + int(RATE * rng.uniform(0.3, 3.0))) + 5 * RATE < rows:
        length = int(RATE * rng.uniform(0.4, 4.0))
        top = rng.uniform(0.05, 1.0) * (-1.0 if place > 0.15 else 1.0)
        command[first : first + length] = top * np.sin(np.pi * np.arange(length) / length) ** 2
        place += 0.05 * top * length / RATE
        at = first + length
    joint = 0.15 + np.cumsum(0.1 * np.roll(command, 30)) / RATE + 2e-5 * rng.standard_normal(rows)
    columns = {"time": np.arange(rows) / RATE, "slide.command": command, "slide.joint": joint}
    folder.mkdir(parents=True)
    pq.write_table(pa.table(columns), folder / "drive.parquet")
    (folder / "machine.toml").write_text(_MACHINE, "utf-8")
    return int(command.nbytes + joint.nbytes)


def taken(workspace: Path, *arguments: str) -> tuple[float, int]:
    """Processor time [s] and most memory [B] of a verb in a process of its own."""
    argv = [sys.executable, "-c", CHILD, "--workspace", str(workspace), *arguments]
    done = subprocess.run(argv, capture_output=True, text=True, check=True)
    seconds, peak = json.loads(done.stdout.splitlines()[-1])
    return seconds, peak


def long_log_rows(repeats: int = 3) -> list[dict[str, Any]]:
    """Each verb against its limits."""
    rows = round(HOURS * 3600.0 * RATE)
    about = f"{HOURS:g} h of command and position at {RATE:g} Hz"
    with tempfile.TemporaryDirectory(prefix="sysid-bench-") as scratch:
        workspace, sizes = Path(scratch) / "workspace", list[int]()
        for name, count in (("short", SHORT), ("long", rows)):
            sizes.append(write_log(Path(scratch) / name, count))
            ingest(Path(scratch) / name, workspace, name=name)
        found = []
        for verb, (first, *options) in VERBS.items():
            base = taken(workspace, first, "short", *options)[1]
            runs = [taken(workspace, first, "long", *options) for _ in range(repeats)]
            held = [(peak - base) / (sizes[1] - sizes[0]) for _, peak in runs]
            note = f"{about}; processor time with imports"
            found.append(against_limit(f"{verb}_of_an_hour", [seconds for seconds, _ in runs], LIMIT_S, "s", note))
            note = f"{about}; most memory above that for a minute, in sizes of the signals"
            found.append(against_limit(f"{verb}_memory", held, LIMIT_SIZES, "sizes", note))
    return found
