"""Networks and calibration on published measurements of arms and servos: held-out errors, compared with simple models.

    .venv/bin/python pipelines/calibration_sets.py DATA          (writes reports/calibration_sets/; tables: reports/networks/)

``DATA`` holds the folders ``tiago_mocap``, ``bam_xl330`` and ``sage_so101`` as downloaded (the READMEs of datasets/tiago, ur10,
xl330 and so101 name the sources). Static poses of two arms: calibrated geometry, perceptrons and simple models, all evaluated
by the same cross-validation, and learning curves over the number of poses. Logs of servos: command → motion, evaluated by free
runs over whole held-out recordings.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from committed import provenance, write_result, write_tables
from measured import poses, servos

ROOT = Path(__file__).resolve().parents[1]


def main(data: Path, folder: Path, page: Path | None = None, quick: bool = False) -> Path:
    """Run both parts on the files in ``data`` and return the path of ``result.json``.

    Args:
        folder: of the result; ``page``: whose tables are written anew.
        quick: fewer folds and recordings, for a test of the line.
    """
    result: dict[str, Any] = provenance("python pipelines/calibration_sets.py DATA", 0, ("scikit-learn", "torch"))
    result["arms"] = {arm.name: poses.evaluated(arm, data / "tiago_mocap", quick) for arm in poses.ARMS}
    result["servos"] = servos.evaluated(data, quick)
    write_result(folder / "result.json", result)
    if page is not None:
        text = f"{poses.tables(result['arms'])}\n\n{servos.table(result['servos'])}"
        write_tables(page, text, "pipelines/calibration_sets.py")
    return folder / "result.json"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder with tiago_mocap, bam_xl330 and sage_so101")
    parser.add_argument("--folder", type=Path, default=ROOT / "reports" / "calibration_sets")
    parser.add_argument("--page", type=Path, default=ROOT / "reports" / "networks" / "README.md")
    given = parser.parse_args()
    main(given.data, given.folder, given.page)
