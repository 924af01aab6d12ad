"""Rows of the logs: a bag to tables beside other readers, memory against size, an hour ingested."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType

from benchmarks.bags import Bag, write_bag
from benchmarks.hour import INGEST_LIMIT, stage_seconds
from benchmarks.rows import against_limit, row

CHILD = Path(__file__).with_name("readers.py")
WHOLE, PART, WARM_UP = Bag(200_000, 200_000), Bag(20_000, 20_000), Bag(200, 200)
PEERS = {"mcap_ros2": "mcap-ros2-support", "rosbags": "rosbags", "rerun": "Rerun McapReader"}
#: Readers of messages take minutes: they get a bag of a tenth, scaled.
SLOW = ("mcap_ros2", "rosbags")
#: Sizes [GB] of the bags whose reading may not take more memory than the limit [MiB], and bytes of a camera's image.
SIZES, MEMORY_LIMIT, IMAGE = (0.5, 1.0, 2.0), 2048.0, 2**20
MIB = 2**20


def measured(reader: str, bag: Path, warm_up: Path) -> dict[str, Any]:
    """Seconds, rows and memory of one reader in a new process."""
    command = [sys.executable, str(CHILD), reader, str(bag), str(warm_up)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"{CHILD.name} {reader} failed:\n{done.stderr.strip()}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def log_rows(repeats: int = 5) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The rows, and the memory of ours against size."""
    with tempfile.TemporaryDirectory(prefix="sysid-bench-") as scratch:
        folder = Path(scratch)
        rows = _reader_rows(folder, repeats)
        memory = _memory(folder)
    worst = max(entry["peak_mib"] for entry in memory if entry["read"] != "everything")
    note = (
        f"the most that any bag of {SIZES[0]:g} to {SIZES[-1]:g} GB took, mapped fields or a look into it, interpreter included"
    )
    rows.append(against_limit("memory_large_bag", [worst], MEMORY_LIMIT, "MiB", note))
    stages = [stage_seconds() for _ in range(3)]
    note = (
        "clocks aligned and channels resampled of one hour, four axes, 100 Hz beside 120 Hz, +40 ppm; reading and storing apart"
    )
    rows.append(against_limit("align_resample_hour", [s["align"] + s["resample"] for s in stages], INGEST_LIMIT, "s", note))
    return rows, memory


def _reader_rows(folder: Path, repeats: int) -> list[dict[str, Any]]:
    bags = {
        name: write_bag(folder / f"{name}.mcap", bag) for name, bag in (("whole", WHOLE), ("part", PART), ("warm", WARM_UP))
    }
    times: dict[str, list[float]] = {name: [] for name in ("ours", *PEERS)}
    peaks: dict[str, float] = {}
    scale = WHOLE.messages / PART.messages
    for _ in range(repeats):
        for name, taken in times.items():
            slow = name in SLOW
            found = measured(name, bags["part" if slow else "whole"], bags["warm"])
            if found["rows"] != (PART if slow else WHOLE).messages:
                raise SystemExit(f"{name} gives {found['rows']} rows")
            taken.append(found["seconds"] * (scale if slow else 1.0))
            peaks[name] = found["peak"] / MIB
    for name in SLOW:
        peaks[name] = measured(name, bags["whole"], bags["warm"])["peak"] / MIB
    size = bags["whole"].stat().st_size / 1e6
    about = f"{WHOLE.messages} JointState and PoseStamped messages, {size:.1f} MB, zstd, to pandas tables of 24 columns"
    rows = []
    for name, peer in PEERS.items():
        scaled = f"; {peer}: a tenth of it, scaled" if name in SLOW else ""
        rows.append(row("ingest_ros2_mcap", peer, times["ours"], times[name], "s", about + scaled))
    for name, peer in PEERS.items():
        note = "peak of the whole process that reads the same bag"
        rows.append(row("ingest_memory", peer, [peaks["ours"]], [peaks[name]], "MiB", note))
    return rows


def _memory(folder: Path) -> list[dict[str, Any]]:
    """Peak memory of ours against the size of the bag: images between few states, and states alone."""
    found = []
    warm_up = write_bag(folder / "warm.mcap", WARM_UP)
    for size in SIZES:
        images = round(size * 1e9 / (IMAGE + 30 * 330))
        kinds = {
            "camera and joint states": Bag(30 * images, 0, images, IMAGE, CompressionType.NONE),
            "joint states": Bag(round(size * 1e9 / 330), compression=CompressionType.NONE),
        }
        for kind, bag in kinds.items():
            path = write_bag(folder / "large.mcap", bag)
            for read in ("mapped", "inspect", "everything"):
                taken = measured(read, path, warm_up)
                found.append(
                    {
                        "bag": kind,
                        "size_gb": path.stat().st_size / 1e9,
                        "messages": bag.messages,
                        "read": read,
                        "seconds": taken["seconds"],
                        "peak_mib": taken["peak"] / MIB,
                        "bytes_a_message": max(0, taken["peak"] - taken["before"]) / bag.messages,
                    }
                )
            path.unlink()
    return found
