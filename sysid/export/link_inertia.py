"""Masses and inertias of the links of a URDF."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from sysid.machine.kinematics import origin_pose
from sysid.machine.urdf_tree import moments_of

Array = npt.NDArray[np.float64]
#: Link → mass (1,) [kg], centre (3,) [m] and inertia about it in the axes of the link (3, 3) [kg·m²].
LinkInertias = Mapping[str, tuple[Array, ...]]
#: Mass [kg] and inertia [kg·m²] of a body whose URDF link has none: a simulator needs some, the drives do not notice it.
SMALL_MASS, SMALL_INERTIA = 1e-9, 1e-9


#: Of every format with masses, for the page of an export.
NOTE = (
    "Moments of inertia that no mass distribution has (one above the sum of the others) are replaced by the nearest possible "
    "ones."
)


def link_inertias(urdf: Element) -> LinkInertias:
    """Those of a URDF; a link without a mass is left out."""
    found: dict[str, tuple[Array, ...]] = {}
    for link in urdf.findall("link"):
        mass, moments = link.find("inertial/mass"), link.find("inertial/inertia")
        if mass is None or float(mass.get("value", "0")) <= 0.0:
            continue
        pose = origin_pose(link.find("inertial/origin"))
        turned = pose[:3, :3] @ possible(moments_of(moments)) @ pose[:3, :3].T
        found[str(link.get("name"))] = (np.array([float(str(mass.get("value")))]), pose[:3, 3], turned)
    return found


def possible(moments: Array) -> Array:
    """Moments (3, 3) of the nearest mass distribution: its second moment tr(I)/2 − I along any direction is at least zero."""
    values, axes = np.linalg.eigh(0.5 * np.trace(moments) * np.eye(3) - moments)
    if values[0] >= 0.0:
        return moments
    second = axes * np.maximum(values, 0.0) @ axes.T
    return np.asarray(np.trace(second) * np.eye(3) - second)
