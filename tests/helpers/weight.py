"""Gravity loads from energy: a URDF's masses lifted and lowered a little. Shares nothing with the plant's kinematics."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]
GRAVITY = 9.80665
#: A URDF without masses carries this at its tip [kg].
UNIT_MASS = 1.0


def slopes(urdf: str, values: dict[str, float], tip: str, step: float = 1e-4) -> list[float]:
    """Central difference of the energy by each of the joints in ``values`` [N·m or N].

    Joints that are not named turn freely and hang at rest; there the energy does not change with them to first order.
    """
    root = ET.fromstring(urdf)
    held = {**values, **_at_rest(root, values, tip)}
    found = []
    for joint, value in values.items():
        above, below = (_energy(root, {**held, joint: value + sign * step}, tip) for sign in (1.0, -1.0))
        found.append((above - below) / (2.0 * step))
    return found


def _at_rest(root: ET.Element, values: dict[str, float], tip: str) -> dict[str, float]:
    """Where the free joints hang: least energy, from several starts."""
    turning = [str(j.get("name")) for j in root.findall("joint") if j.get("type") in ("revolute", "continuous")]
    free = [name for name in turning if name not in values]
    if not free:
        return {}
    starts = np.stack(np.meshgrid(*[[-1.0, 2.0]] * len(free)), axis=-1).reshape(-1, len(free))

    def energy(x: Array) -> float:
        return _energy(root, {**values, **dict(zip(free, x, strict=True))}, tip)

    best = min((minimize(energy, start, method="BFGS", tol=1e-9) for start in starts), key=lambda found: float(found.fun))
    return dict(zip(free, map(float, best.x), strict=True))


def _energy(root: ET.Element, values: dict[str, float], tip: str) -> float:
    frames = _frames(root, values)
    masses = [
        (float(mass.get("value", "0")), _numbers(link.find("inertial/origin"), "xyz"), str(link.get("name")))
        for link in root.findall("link")
        if (mass := link.find("inertial/mass")) is not None
    ]
    masses = masses or [(UNIT_MASS, np.zeros(3), tip)]
    return GRAVITY * sum(mass * float((frames[link][0].apply(centre) + frames[link][1])[2]) for mass, centre, link in masses)


def _frames(root: ET.Element, values: dict[str, float]) -> dict[str, tuple[Rotation, Array]]:
    """Rotation and place of every link."""
    joints = root.findall("joint")
    children = {str(j.find("child").get("link")) for j in joints}  # type: ignore[union-attr]
    links = [str(link.get("name")) for link in root.findall("link")]
    frames = {link: (Rotation.identity(), np.zeros(3)) for link in links if link not in children}
    while len(frames) < len(links):
        for joint in joints:
            parent, child = (str(joint.find(role).get("link")) for role in ("parent", "child"))  # type: ignore[union-attr]
            if parent in frames and child not in frames:
                turn, place = frames[parent]
                origin = joint.find("origin")
                place = place + turn.apply(_numbers(origin, "xyz"))
                turn = turn * Rotation.from_euler("xyz", _numbers(origin, "rpy"))
                along, value = _numbers(joint.find("axis"), "xyz"), values.get(str(joint.get("name")), 0.0)
                if joint.get("type") == "prismatic":
                    place = place + turn.apply(value * along)
                elif joint.get("type") != "fixed":
                    turn = turn * Rotation.from_rotvec(value * along)
                frames[child] = turn, place
    return frames


def _numbers(element: ET.Element | None, key: str) -> Array:
    return np.array([float(word) for word in (element.get(key, "0 0 0") if element is not None else "0 0 0").split()])
