"""Side by side with neighbouring tools, on the same logs, alternating: `make bench` writes reports/bench/result.json.

The figures are ratios of times measured in turn on one machine (above 1: ours is better); absolute times depend on the machine.
The command line is measured here, logs and the plant in benchmarks/. docs/speed.md shows the result.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.logs import log_rows
from benchmarks.plant import plant_rows
from benchmarks.rows import against_limit, seconds
from committed import provenance, write_result, write_tables

ROOT = Path(__file__).resolve().parents[1]
RESULT = ROOT / "reports" / "bench" / "result.json"
PAGE = ROOT / "docs" / "speed.md"
PACKAGES = ("mcap-ros2-support", "rosbags", "rerun-sdk", "pandas", "click", "mujoco-core", "pybullet")
#: `sysid --help` has to answer within this time [s].
HELP_LIMIT = 0.5


def help_seconds() -> float:
    program = [sys.executable, "-c", "from sysid.cli import main; main()", "--help"]
    return seconds(lambda: subprocess.run(program, check=True, capture_output=True))


def tables(rows: list[dict[str, Any]], memory: list[dict[str, Any]]) -> str:
    """The result as two tables of a page."""
    lines = ["| work | beside | ratio (lowest to highest) | ours | theirs |", "| --- | --- | --- | --- | --- |"]
    for entry in rows:
        ratio, unit = entry["ratio"], entry["unit"]
        figures = " | ".join(f"{entry[side]:.3g} {unit}" for side in ("ours", "theirs"))
        spread = f"**{ratio['median']:.3g}** ({ratio['min']:.3g} to {ratio['max']:.3g})"
        lines.append(f"| {entry['work'].replace('_', ' ')} | {entry['peer']} | {spread} | {figures} |")
    lines += ["", "| bag | size | messages | read | most memory | for each message |", "| --- | --- | --- | --- | --- | --- |"]
    for entry in memory:
        size = f"{entry['size_gb']:.2f} GB | {entry['messages']} | {entry['read']}"
        each = f"{entry['bytes_a_message']:.0f} B" if entry["bag"] == "joint states" else ""
        lines.append(f"| {entry['bag']} | {size} | {entry['peak_mib']:.0f} MiB | {each} |")
    return "\n".join(lines)


def main() -> Path:
    helps = [help_seconds() for _ in range(6)][1:]
    of_logs, memory = log_rows()
    rows = [*of_logs, against_limit("cli_help", helps, HELP_LIMIT, "s"), *plant_rows()]
    write_result(RESULT, provenance("make bench", None, PACKAGES) | {"rows": rows, "memory": memory})
    write_tables(PAGE, tables(rows, memory), "make bench")
    for entry in rows:
        ratio = entry["ratio"]
        against = f"{entry['ours']:.4g} {entry['unit']} against {entry['theirs']:.4g} of {entry['peer']}"
        print(f"{entry['work']:22s} {against}: {ratio['median']:.2f} × ({ratio['min']:.2f} to {ratio['max']:.2f})")
    print(RESULT.relative_to(ROOT))
    return RESULT


if __name__ == "__main__":
    main()
