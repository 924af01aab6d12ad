"""Answers one case from its site alone: ingest, then the gap of the plant that the machine description gives.

python -m arms.solve SITE ANSWER.json
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from sysid.datasets import ingest
from sysid.errors import SysidError
from sysid.gap import find_gap
from sysid.plant import nominal_plant


def solve(site: Path, out: Path) -> None:
    """Write the answer, or the error with which the workflow refuses, and the times of the gap run [s]."""
    with tempfile.TemporaryDirectory() as workspace:
        begin, processor = time.perf_counter(), time.process_time()
        answer: dict[str, Any]
        try:
            dataset = ingest(site, workspace)
            begin, processor = time.perf_counter(), time.process_time()
            found = find_gap(dataset, nominal_plant(dataset.machine)).to_json()
            answer = {"answer": {key: value for key, value in found.items() if key != "maps"}}
        except SysidError as error:
            answer = {"refused": str(error)}
        answer |= {"wall_seconds": time.perf_counter() - begin, "seconds": time.process_time() - processor}
    beside = out.with_suffix(".part")
    beside.write_text(json.dumps(answer, indent=1) + "\n", "utf-8")
    beside.replace(out)


if __name__ == "__main__":
    solve(Path(sys.argv[1]), Path(sys.argv[2]))
