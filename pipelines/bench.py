"""Compares time and memory with other tools on the same logs: `make bench` writes reports/bench/.

The figures are ratios of times measured alternately on one machine; above 1, sysid is better. The parts are in benchmarks/.
`make bench PARTS="readers memory"` measures these parts and keeps the rows of the others. The ratios also go to history.json;
the command fails where one to another tool is lower by more than 15 % than when last measured on the same kind of computer.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.gap import gap_rows
from benchmarks.history import fallen, read_history, write_history
from benchmarks.logs import ingest_rows, memory_rows, reader_rows
from benchmarks.long_log import long_log_rows
from benchmarks.motion import motion_rows
from benchmarks.networks import network_rows
from benchmarks.plant import plant_rows
from benchmarks.registry import registry_rows
from benchmarks.rows import against_limit, seconds
from benchmarks.training import training_rows
from committed import markdown, provenance, write_result, write_tables

ROOT = Path(__file__).resolve().parents[1]
RESULT = ROOT / "reports" / "bench" / "result.json"
HISTORY = ROOT / "reports" / "bench" / "history.json"
PAGE = ROOT / "reports" / "bench" / "README.md"
PACKAGES = (
    "mcap-ros2-support",
    "rosbags",
    "rerun-sdk",
    "pandas",
    "click",
    "mujoco-core",
    "pybullet",
    "torch",
    "scikit-learn",
    "stable-baselines3",
)
#: `sysid --help` has to answer within this time [s].
HELP_LIMIT = 0.5


def help_seconds() -> float:
    program = [sys.executable, "-P", "-c", "from sysid.cli import main; main()", "--help"]
    return seconds(lambda: subprocess.run(program, check=True, capture_output=True))


def cli_rows() -> list[dict[str, Any]]:
    helps = [help_seconds() for _ in range(6)][1:]
    return [against_limit("cli_help", helps, HELP_LIMIT, "s")]


#: Part → what measures it. A part can be measured alone: the rows of the others then stay as they were, with their date.
PARTS: dict[str, Callable[[], list[dict[str, Any]]]] = {
    "readers": reader_rows,
    "memory": memory_rows,
    "ingest": ingest_rows,
    "long_log": long_log_rows,
    "cli": cli_rows,
    "registry": registry_rows,
    "plant": plant_rows,
    "gap": gap_rows,
    "networks": network_rows,
    "motion": motion_rows,
    "training": training_rows,
}


def tables(rows: list[dict[str, Any]]) -> str:
    """The result as two tables of a page: ratios, and memory against the size of a bag."""
    lines, sizes = [], []
    for entry in rows:
        ratio, unit = entry["ratio"], entry["unit"]
        if "bag" in entry:
            bag = entry["bag"]
            each = f"{bag['bytes_a_message']:.0f} B" if bag["content"] == "joint states" else ""
            size = f"{bag['size_gb']:.2f} GB"
            sizes.append((bag["content"], size, str(bag["messages"]), bag["read"], f"{entry['ours']:.0f} MiB", each))
            continue
        figures = (f"{entry[side]:.3g} {unit}" for side in ("ours", "theirs"))
        spread = f"**{ratio['median']:.3g}** ({ratio['min']:.3g} to {ratio['max']:.3g})"
        lines.append((entry["work"].replace("_", " "), entry["peer"], spread, *figures))
    ratios = markdown(("work", "compared with", "ratio (lowest to highest)", "sysid", "other"), lines, "lllll")
    memory = markdown(("bag", "size", "messages", "read", "peak memory", "per message"), sizes, "llllll")
    return f"{ratios}\n\n{memory}"


def main(parts: Sequence[str]) -> Path:
    """Measure ``parts``, all of them where none is named."""
    unknown = set(parts) - set(PARTS)
    if unknown:
        raise SystemExit(f"no part {', '.join(sorted(unknown))}; expected some of: {', '.join(PARTS)}")
    known = json.loads(RESULT.read_text("utf-8"))["rows"] if parts and RESULT.exists() else []
    head = provenance("make bench", None, PACKAGES)
    rows, measured = list[dict[str, Any]](), list[dict[str, Any]]()
    for part, measure in PARTS.items():
        if parts and part not in parts:
            rows += [entry for entry in known if entry["part"] == part]
            continue
        fresh = [{"part": part, "date": head["date"], **entry} for entry in measure()]
        for entry in fresh:
            ratio = entry["ratio"]
            against = f"{entry['ours']:.4g} {entry['unit']} against {entry['theirs']:.4g} of {entry['peer']}"
            print(f"{entry['work']:22s} {against}: {ratio['median']:.2f} × ({ratio['min']:.2f} to {ratio['max']:.2f})")
        rows += fresh
        measured += fresh
    write_result(RESULT, head | {"rows": rows})
    write_tables(PAGE, tables(rows), "make bench")
    print(RESULT.relative_to(ROOT))
    history = read_history(HISTORY)
    lower = fallen(measured, head["machine"], history)
    write_history(HISTORY, history, head, measured)
    if lower:
        raise SystemExit("lower by more than 15 % than when last measured:\n  " + "\n  ".join(lower))
    return RESULT


if __name__ == "__main__":
    main(sys.argv[1:])
