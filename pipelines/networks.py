"""Errors of forward models and actuator networks on the bench crane, compared with simpler models.

    .venv/bin/python pipelines/networks.py [--workspace workspace] [--fresh]

Forward models: poses from the crane's own forward kinematics, uniform over the full joint ranges and over a sub-space (slew
±45°, the middle 70 % of the others), joints and tip with the noise of motion capture; five seeds, 1000 other poses.
Actuator networks: the shipped logs, evaluated in a recording that nothing has learned from and against the true linkage. Every
part is kept in the workspace when it is done, and a run that was interrupted goes on where it was, within a training as well.
Writes ``reports/networks/`` and the tables of ``reports/networks/README.md``.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from committed import provenance, write_result, write_tables
from learned import actuators, forward, shipped
from learned.page import tables
from learned.pictures import pictures
from learned.poses import JOINT_NOISE, PART_SHARE, TIP_NOISE
from sysid.datasets import ingest
from sysid.networks import Checkpoints

ROOT = Path(__file__).resolve().parents[1]
AUTOLOG, FOLDER = ROOT / "datasets" / "autolog", ROOT / "reports" / "networks"
PAGE = FOLDER / "README.md"
PIPELINE = "pipelines/networks.py"


def main(workspace: Path, fresh: bool = False) -> dict[str, Any]:
    """Run what is not there yet; returns the result."""
    folder, seconds = workspace / "networks", {}
    folder.mkdir(parents=True, exist_ok=True)

    def part(name: str, make: Callable[[], Any]) -> Any:
        path = folder / f"{name}.json"
        if fresh or not path.exists():
            begin = time.perf_counter()
            rows = make()
            write_result(path, {"rows": rows, "seconds": round(time.perf_counter() - begin, 1)})
        found = json.loads(path.read_text("utf-8"))
        seconds[name] = found["seconds"]
        print(f"{name}: {len(found['rows'])} rows, {found['seconds']:.0f} s", flush=True)
        return found["rows"]

    training = Checkpoints(folder / "training")
    variants = part("variants", lambda: forward.variants(training))
    curve = part("forward", lambda: forward.curve(variants, training))
    dataset = ingest(AUTOLOG, workspace)
    return {
        **provenance(f"python {PIPELINE}", 0, ("torch", "scikit-learn")),
        "conditions": {
            "poses": forward.POSES, "held_out": 1000, "seeds": len(forward.SEEDS), "part": [45.0, PART_SHARE],
            "joint_noise": JOINT_NOISE.tolist(), "tip_noise": TIP_NOISE.tolist(), "actuator_seeds": len(actuators.SEEDS),
        },
        "variants": variants,
        "forward": curve,
        "actuators": part("actuators", lambda: actuators.curve(dataset, training)),
        "shipped": part("shipped", lambda: shipped.reached(dataset)),
        "seconds": seconds,
    }  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workspace", type=Path, default=Path("workspace"))
    parser.add_argument("--fresh", action="store_true", help="do every part again")
    options = parser.parse_args()
    result = main(options.workspace, options.fresh)
    write_result(FOLDER / "result.json", result)
    for name, picture in pictures(result).items():
        (FOLDER / name).write_text(picture, "utf-8")
    write_tables(PAGE, tables(result), PIPELINE)
