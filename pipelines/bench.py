"""Side by side with neighbouring tools, on the same logs, alternating: `make bench` writes reports/bench/result.json.

The figures are ratios of times measured in turn on one machine (above 1: ours is better); absolute times depend on the machine.
Reading of logs and the command line are here, the plant beside PyBullet and MuJoCo in benchmarks/.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader

from benchmarks.plant import plant_rows
from benchmarks.rows import against_limit, in_turns, row, seconds
from committed import provenance, write_result
from sysid.logs import ReadOptions, reader_for

ROOT = Path(__file__).resolve().parents[1]
LOGS = sorted((ROOT / "datasets" / "autolog" / "logs").glob("manual-*/machine.mcap"))
RESULT = ROOT / "reports" / "bench" / "result.json"
PACKAGES = ("mcap-ros2-support", "rosbags", "pandas", "click", "mujoco-core", "pybullet")
#: `sysid --help` has to answer within this time [s].
HELP_LIMIT = 0.5


def side_by_side(
    work: str, peer: str, ours: Callable[[], object], theirs: Callable[[], object], repeats: int
) -> dict[str, Any]:
    """One row of the result: the two take turns."""
    taken = in_turns({"ours": ours, "theirs": theirs}, repeats)
    return row(work, peer, taken["ours"], taken["theirs"])


def ours_read() -> int:
    """Every message of the shipped bags as columns."""
    return sum(len(stream) for path in LOGS for stream in reader_for(path).read(path, ReadOptions()))


def mcap_ros2_read() -> int:
    """The same messages as lists of values, the way one fills a table from that reader."""
    count = 0
    for path in LOGS:
        rows: list[list[float]] = []
        for message in read_ros2_messages(str(path)):
            values = message.ros_msg
            stamp = values.header.stamp
            numbers = values.command if hasattr(values, "command") else values.position
            rows.append([stamp.sec + 1e-9 * stamp.nanosec, message.log_time_ns, *numbers])
        count += len(rows)
    return count


def rosbags_read() -> int:
    """The same with rosbags."""
    count = 0
    for path in LOGS:
        rows: list[list[float]] = []
        with AnyReader([path]) as reader:
            for connection, log_time, data in reader.messages():
                values: Any = reader.deserialize(data, connection.msgtype)
                numbers = values.command if hasattr(values, "command") else values.position
                rows.append([values.header.stamp.sec + 1e-9 * values.header.stamp.nanosec, log_time, *numbers])
        count += len(rows)
    return count


def help_seconds() -> float:
    program = [sys.executable, "-c", "from sysid.cli import main; main()", "--help"]
    return seconds(lambda: subprocess.run(program, check=True, capture_output=True))


def main() -> Path:
    counts = {read.__name__: read() for read in (ours_read, mcap_ros2_read, rosbags_read)}
    if len(set(counts.values())) != 1:
        raise SystemExit(f"the readers disagree on the number of messages: {counts}")
    helps = [help_seconds() for _ in range(6)][1:]
    rows = [
        side_by_side("ingest_ros2_mcap", "mcap-ros2-support", ours_read, mcap_ros2_read, 3),
        side_by_side("ingest_ros2_mcap", "rosbags", ours_read, rosbags_read, 3),
        against_limit("cli_help", helps, HELP_LIMIT, "s"),
        *plant_rows(),
    ]
    write_result(RESULT, provenance("make bench", None, PACKAGES) | {"messages": counts["ours_read"], "rows": rows})
    for entry in rows:
        ratio = entry["ratio"]
        against = f"{entry['ours']:.4g} {entry['unit']} against {entry['theirs']:.4g} of {entry['peer']}"
        print(f"{entry['work']:22s} {against}: {ratio['median']:.2f} × ({ratio['min']:.2f} to {ratio['max']:.2f})")
    print(RESULT.relative_to(ROOT))
    return RESULT


if __name__ == "__main__":
    main()
