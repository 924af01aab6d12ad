"""Masses and inertias of the links of a URDF."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from sysid.machine.kinematics import origin_pose
from sysid.machine.urdf_tree import urdf_tree

Array = npt.NDArray[np.float64]
#: Link → mass (1,) [kg], centre (3,) [m] and inertia about it in the axes of the link (3, 3) [kg·m²].
LinkInertias = Mapping[str, tuple[Array, ...]]
#: Mass [kg] and inertia [kg·m²] of a body whose URDF link has none: a simulator needs some, the drives do not notice it.
SMALL_MASS, SMALL_INERTIA = 1e-9, 1e-9


def link_inertias(urdf: str) -> LinkInertias:
    """Those of a URDF."""
    found: dict[str, tuple[Array, ...]] = {}
    for link in urdf_tree(urdf).findall("link"):
        mass, moments = link.find("inertial/mass"), link.find("inertial/inertia")
        if mass is None:
            continue
        pose = origin_pose(link.find("inertial/origin"))
        inertia = np.zeros((3, 3))
        if moments is not None:
            for i, j, key in ((0, 0, "ixx"), (1, 1, "iyy"), (2, 2, "izz"), (0, 1, "ixy"), (0, 2, "ixz"), (1, 2, "iyz")):
                inertia[i, j] = inertia[j, i] = float(moments.get(key, "0"))
        turned = pose[:3, :3] @ inertia @ pose[:3, :3].T
        found[str(link.get("name"))] = (np.array([float(mass.get("value", "0"))]), pose[:3, 3], turned)
    return found
