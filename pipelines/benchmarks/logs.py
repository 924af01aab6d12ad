"""Rows of the logs: a bag to tables beside other readers, memory against size, an hour ingested."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType

from benchmarks.bags import Bag, write_bag
from benchmarks.hour import INGEST_LIMIT, stage_seconds
from benchmarks.rows import against_limit, in_process, row

CHILD = Path(__file__).with_name("readers.py")
WHOLE, PART, WARM_UP = Bag(200_000, 200_000), Bag(20_000, 20_000), Bag(200, 200)
PEERS = {
    "mcap_ros2": "mcap-ros2-support",
    "mcap_ros2_file_order": "mcap-ros2-support, in file order",
    "rosbags": "rosbags",
    "rerun": "Rerun McapReader",
}
#: Readers of messages take minutes: they get a bag of a tenth, scaled.
SLOW = ("mcap_ros2", "mcap_ros2_file_order", "rosbags")
#: Sizes [GB] of the bags whose reading may not take more memory than the limit [MiB]; bytes of an image and of a joint state.
SIZES, MEMORY_LIMIT, IMAGE, STATE = (0.5, 1.0, 2.0), 2048.0, 2**20, 290
MIB = 2**20


def measured(reader: str, bag: Path, warm_up: Path) -> dict[str, Any]:
    """Seconds, rows and memory of one reader in a new process."""
    return in_process(CHILD, reader, str(bag), str(warm_up))


def reader_rows(repeats: int = 5) -> list[dict[str, Any]]:
    """Time and memory of `sysid` and of each other tool on the same bag."""
    times: dict[str, list[float]] = {name: [] for name in ("ours", *PEERS)}
    peaks: dict[str, float] = {}
    scale = WHOLE.messages / PART.messages
    with tempfile.TemporaryDirectory(prefix="sysid-bench-") as scratch:
        whole, part, warm = (write_bag(Path(scratch) / f"{k}.mcap", bag) for k, bag in enumerate((WHOLE, PART, WARM_UP)))
        for _ in range(repeats):
            for name, taken in times.items():
                slow = name in SLOW
                found = measured(name, part if slow else whole, warm)
                if found["rows"] != (PART if slow else WHOLE).messages:
                    raise SystemExit(f"{name} gives {found['rows']} rows")
                taken.append(found["seconds"] * (scale if slow else 1.0))
                peaks[name] = found["peak"] / MIB
        for name in SLOW:
            peaks[name] = measured(name, whole, warm)["peak"] / MIB
        size = whole.stat().st_size / 1e6
    about = f"{WHOLE.messages} JointState and PoseStamped messages, {size:.1f} MB, zstd, to pandas tables of 17 and 9 columns"
    note = "most memory of the whole process that reads this bag"
    rows = []
    for name, peer in PEERS.items():
        scaled = f"; {peer}: a tenth of it, scaled" if name in SLOW else ""
        rows.append(row("ingest_ros2_mcap", peer, times["ours"], times[name], "s", about + scaled))
    return [*rows, *(row("ingest_memory", PEERS[name], [peaks["ours"]], [peaks[name]], "MiB", note) for name in PEERS)]


def memory_rows() -> list[dict[str, Any]]:
    """Memory of `sysid` by size of the bag: images between few states, and states alone."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="sysid-bench-") as scratch:
        warm_up = write_bag(Path(scratch) / "warm.mcap", WARM_UP)
        for size in SIZES:
            images = round(size * 1e9 / (IMAGE + 30 * STATE))
            kinds = {
                "camera and joint states": Bag(30 * images, 0, images, IMAGE, CompressionType.NONE),
                "joint states": Bag(round(size * 1e9 / STATE), compression=CompressionType.NONE),
            }
            for kind, bag in kinds.items():
                path = write_bag(Path(scratch) / "large.mcap", bag)
                for read in ("mapped", "inspect", "everything"):
                    found = measured(read, path, warm_up)
                    of_bag = {
                        "content": kind,
                        "size_gb": path.stat().st_size / 1e9,
                        "messages": bag.messages,
                        "read": read,
                        "bytes_a_message": max(0, found["peak"] - found["before"]) / bag.messages,
                    }
                    note = "most memory of the whole process"
                    entry = against_limit("memory_of_a_bag", [found["peak"] / MIB], MEMORY_LIMIT, "MiB", note)
                    rows.append({**entry, "bag": of_bag})
                path.unlink()
    return rows


def ingest_rows(repeats: int = 3) -> list[dict[str, Any]]:
    """The hour: alignment and resampling."""
    stages = [stage_seconds() for _ in range(repeats)]
    taken = [stage["align"] + stage["resample"] for stage in stages]
    others = ", ".join(
        f"{name} {sorted(stage[name] for stage in stages)[repeats // 2]:.1f} s" for name in ("read", "check", "store")
    )
    about = "clocks aligned and channels resampled of an hour, four axes, 100 Hz beside 120 Hz at +40 ppm"
    note = f"{about}; apart from that: {others}"
    return [against_limit("align_resample_hour", taken, INGEST_LIMIT, "s", note)]
