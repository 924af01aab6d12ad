"""The distance from the path of the task."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from sysid_rl.run.checks.settings import PathCheck
from sysid_rl.run.cycle import Violation
from sysid_rl.run.modes.mode import Goal

Array = npt.NDArray[np.float64]

#: Time by which a machine may be behind its path beyond dead time and look-ahead [s].
BEHIND_S = 0.2


class PathDistance:
    """Distance of end effector and setpoints from the last piece of the path, as long as the plant's response and look-ahead.

    The path is that of the aims of the task; where the task states joints, that of the setpoints.

    Args:
        rule: of the recipe.
        tip: joints (n, A) → end effector (n, 3) [m].
        response: of the machine, and look-ahead of the aims [s].
        dt: of a cycle.
    """

    def __init__(self, rule: PathCheck, tip: Callable[[Array], Array], response: float, dt: float) -> None:
        self.rule, self.tip = rule, tip
        self._path: deque[Array] = deque(maxlen=2 + round((response + BEHIND_S) / dt))

    def begin(self) -> None:
        """Forget the path."""
        self._path.clear()

    def check(self, goal: Goal, setpoints: Array, ee: Array) -> list[Violation]:
        """The violation of this cycle, if any, for setpoints (A,) and the end effector (3,)."""
        commanded = self.tip(setpoints[None])[0]
        stated = bool(np.isfinite(goal.aim).all())
        self._path.append(goal.aim.copy() if stated else commanded)
        path = np.array(self._path)
        limit = self.rule.distance
        for point, words in ((ee, "the end effector is"), *([(commanded, "the setpoints are")] if stated else [])):
            distance = _distance(point, path)
            if distance > limit:
                text = f"{words} {1e3 * distance:.0f} mm off the path, limit {1e3 * limit:.0f} mm"
                return [Violation("path", "ee", self.rule.reaction, distance, limit, text)]
        return []


def _distance(point: Array, path: Array) -> float:
    """Distance of a point (3,) from a polyline (n, 3)."""
    begins, ways = path[:-1] if len(path) > 1 else path, np.diff(path, axis=0) if len(path) > 1 else np.zeros((1, 3))
    along = np.einsum("ij,ij->i", point - begins, ways) / np.maximum(np.einsum("ij,ij->i", ways, ways), 1e-18)
    nearest = begins + np.clip(along, 0.0, 1.0)[:, None] * ways
    return float(np.linalg.norm(point - nearest, axis=1).min())
