"""Parameters that are not identifiable with the geometry of a recipe."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recipe import StreamMap
from sysid.machine import Machine

Array = npt.NDArray[np.float64]

#: Least cosine of the angle between an offset and the last link for which they count as parallel.
ALONG = 0.9


def offset_notes(
    streams: Sequence[StreamMap], mounts: Mapping[tuple[str, str], Mapping[str, Array]], machine: Machine
) -> list[str]:
    """A note for every ``ee`` whose surveyed offset is along the last link: its error and a link length error are equivalent.

    Args:
        mounts: (recording, key of the entry) → body → its pose on its link.
    """
    kinematics = machine.kinematics()
    notes: list[str] = []
    for mapping in streams:
        point = mapping.points.get("ee")
        if kinematics is None or point is None or point.body not in mapping.bodies or mapping.reference is None:
            continue
        mount = next(
            (own[point.body] for (_, files), own in mounts.items() if files == mapping.key and point.body in own), None
        )
        if mount is None or not any(point.at):
            continue
        poses = kinematics.link_poses(np.array([[mapping.reference.joints[name] for name in machine.axis_names]]))
        revolute = [joint for joint in kinematics.chain if joint.kind in ("revolute", "continuous")]
        if not revolute:
            continue
        joint = revolute[-1]
        link = poses[kinematics.tip][0, :3, 3] - poses[joint.child][0, :3, 3]
        at = (poses[mapping.bodies[point.body]][0] @ mount)[:3, :3] @ np.array(point.at)
        length = float(np.linalg.norm(link))
        along = float(at @ link) / length if length > 0.0 else 0.0
        if length > 0.0 and abs(along) > ALONG * float(np.linalg.norm(at)):
            axis = machine.axis_names[kinematics.drives[joint.name].column]
            notes.append(
                f"ee: the offset of {point.body!r} reaches {1e3 * along:+.1f} mm along the last link. Its error and an error "
                f"of the length of that link (link_length_error of {axis}) are not distinguishable in these data: survey the "
                "offset as accurately as the length has to be known"
            )
    return notes
