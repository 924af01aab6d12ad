"""The paper's autonomous collection: random joint configurations within the limits, settle, record."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.runner.barrier import outside
from sysid.runner.limits import Limits
from sysid.runner.modes.mode import Goal, Move, done

Array = npt.NDArray[np.float64]

#: Points of a move at which the fence is looked at.
_LOOKED_AT = 12
#: Configurations that are tried for each one that is kept.
_TRIES = 200


def draw(count: int, begin: Array, limits: Limits, tip: Callable[[Array], Array], seed: int) -> Array:
    """Joints (count, A) at random within the limits, so that they, and the straight moves between them, stay inside the fence.

    Args:
        begin: joints (A,) where the machine stands.
        tip: joints (n, A) → end effector (n, 3) [m].

    Raises:
        SettingsError: hardly any configuration does.
    """
    rng = np.random.default_rng(seed)
    shares = np.linspace(0.0, 1.0, _LOOKED_AT)[:, None]
    last = np.clip(begin, limits.low, limits.high)
    found: list[Array] = []
    for _ in range(count):
        for _ in range(_TRIES):
            joints = rng.uniform(limits.low, limits.high)
            ends = tip(last + shares * (joints - last))
            left = outside(ends, limits.fence_low, limits.fence_high)
            if not left[-1] and (left <= left[0]).all():
                break
        else:
            where = f"collect: pose {len(found) + 1}"
            raise SettingsError(where, f"none of {_TRIES} draws stays inside the fence", "more room in limits.fence")
        found.append(joints)
        last = joints
    return np.array(found)


class Collect:
    """Go to each of the configurations, settle, stay while it is recorded.

    Args:
        poses: configurations (n, A), or how many to draw where the run starts.
        limits, tip, dt: of the machine.
        settle_s, record_s: at each of them.
        seed: of the draw.
    """

    name, moves, writes, thinks = "collect", True, True, True

    def __init__(
        self,
        poses: int | Array,
        limits: Limits,
        tip: Callable[[Array], Array],
        dt: float,
        *,
        settle_s: float = 1.0,
        record_s: float = 0.5,
        seed: int = 0,
    ) -> None:
        self._asked, self._limits, self._tip, self._dt, self._seed = poses, limits, tip, dt, seed
        self._stay = round(settle_s / dt), round(record_s / dt)
        self.poses = np.empty((0, len(limits.low)))
        self._next, self._begun = 0, 0
        self._move: Move | None = None

    def begin(self, joints: Array, ee: Array) -> None:
        asked = self._asked
        self.poses = draw(asked, joints, self._limits, self._tip, self._seed) if isinstance(asked, int) else np.array(asked)
        self._next, self._begun = 0, 0
        self._move = Move(joints, self.poses[0], self._limits, self._dt)

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        assert self._move is not None
        settle, record = self._stay
        if k - self._begun >= self._move.steps + settle + record:
            self._next += 1
            if self._next >= len(self.poses):
                return done("collect")
            self._move = Move(self.poses[self._next - 1], self.poses[self._next], self._limits, self._dt)
            self._begun = k
        since = k - self._begun - self._move.steps
        phase = "move" if since < 0 else "settle" if since < settle else "record"
        return Goal(f"{phase} {self._next + 1}", joints=self._move.at(k - self._begun + 1))
