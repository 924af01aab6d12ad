"""Runs the workflow on one site with logs and description only, without the truth."""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Any

from sysid.datasets import ingest
from sysid.gap import find_gap
from sysid.plant import nominal_plant


def solve(site: Path, out: Path) -> None:
    """Write what :func:`sysid.gap.find_gap` answers about the logs in ``site``, and the processor time of that."""
    begin = time.process_time()
    with tempfile.TemporaryDirectory() as workspace:
        dataset = ingest(site, workspace)
        ingested = time.process_time() - begin
        result = find_gap(dataset, nominal_plant(dataset.machine))
    answer = {"ingest_seconds": ingested, "seconds": time.process_time() - begin, "answer": _without_maps(result.to_json())}
    beside = out.with_suffix(".part")
    beside.write_text(json.dumps(answer, indent=1) + "\n", "utf-8")
    beside.replace(out)


def _without_maps(answer: dict[str, Any]) -> dict[str, Any]:
    """The answer without its error maps, which are large and not scored."""
    return {key: value for key, value in answer.items() if key != "maps"}
