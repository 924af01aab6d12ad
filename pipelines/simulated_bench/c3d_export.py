"""The capture system's log as a C3D trial: every marker of every rigid body, in millimetres, stored as floats.

C3D has no stamps: the time of a frame follows from its number. Frames that were not exported (between the poses of the
calibration routine) have no marker, and a missing marker has the residual −1. The format has no rigid bodies.
"""

from __future__ import annotations

from pathlib import Path

import ezc3d
import numpy as np

from simulated_bench.capture import Capture
from simulated_bench.capture_recipe import marker_label


def write_c3d(take: Capture, path: Path) -> None:
    """Write the markers of ``take``."""
    labels = [marker_label(body.name, i) for body in take.bodies for i in range(body.markers.shape[1])]
    seen = np.concatenate([body.markers for body in take.bodies], axis=1)
    whole = np.full((int(take.frames[-1]) + 1, len(labels), 3), np.nan)
    whole[take.frames] = 1e3 * seen
    points = np.ones((4, len(labels), len(whole)))
    points[:3] = whole.transpose(2, 1, 0)
    trial = ezc3d.c3d()
    trial["parameters"]["POINT"]["RATE"]["value"] = [take.rate]
    trial["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    trial["parameters"]["POINT"]["LABELS"]["value"] = labels
    trial.add_parameter("MANUFACTURER", "COMPANY", ["sysid.bench"])
    trial["data"]["points"] = points
    trial["data"]["meta_points"]["residuals"] = np.where(np.isnan(points[:1]), -1.0, 0.0)
    trial.write(str(path))
