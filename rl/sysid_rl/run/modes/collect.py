"""The paper's autonomous collection of poses: random joint configurations within the limits, settle, record."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid_rl.run.command_filter import CommandFilter, outside
from sysid_rl.run.modes.mode import Goal, Move, done

Array = npt.NDArray[np.float64]

#: Samples of a move at which the fence is checked.
_SAMPLES = 24
#: Allowance for the tracking error [m].
CLEARANCE = 0.01
#: Most random draws for each accepted configuration.
_TRIES = 200


class SafeMoves:
    """Tests whether straight moves, and stops from any point on them, stay inside the fence."""

    def __init__(self, command_filter: CommandFilter) -> None:
        self.command_filter, self.limits = command_filter, command_filter.limits

    def outside(self, begin: Array, end: Array) -> float:
        """Distance by which the move from ``begin`` to ``end`` (A,), or a stop from it, leaves the fence less a clearance [m].

        For a move that begins outside, only a larger distance counts.
        """
        if not self.limits.fenced:
            return 0.0
        joints, speeds = Move(begin, end, self.limits, self.command_filter.dt).sample(_SAMPLES)
        ends = self.command_filter.tip(np.concatenate([joints, self.command_filter.stop_ends(joints, speeds)]))
        left = outside(ends, self.limits.fence_low + CLEARANCE, self.limits.fence_high - CLEARANCE)
        return max(float(left[len(joints) - 1]), float(left.max()) - float(left[0]))


def draw_poses(count: int, safe_moves: SafeMoves, seed: int) -> Array:
    """Random joints (count, A) within the limits; the moves between them, and from the last to the first, are safe.

    Raises:
        SettingsError: no safe configuration in :data:`_TRIES` draws.
    """
    rng = np.random.default_rng(seed)
    low, high = safe_moves.limits.low, safe_moves.limits.high
    found: list[Array] = []
    for number in range(count):
        for _ in range(_TRIES):
            joints = rng.uniform(low, high)
            first, last = (found[0], found[-1]) if found else (joints, joints)
            closed = number < count - 1 or safe_moves.outside(joints, first) == 0.0
            if closed and safe_moves.outside(last, joints) == 0.0:
                break
        else:
            where = f"collect: pose {number + 1}"
            raise SettingsError(where, f"none of {_TRIES} draws stays inside the fence", "a larger limits.fence")
        found.append(joints)
    return np.array(found)


class Collect:
    """Move to each configuration, settle, and hold while it is recorded.

    Args:
        poses: configurations (n, A), or their number for a random draw.
        safe_moves, dt: of the machine.
        settle_s, record_s: at each configuration.
        seed: of the draw.

    Raises:
        SettingsError: hardly any configuration stays inside the fence.
    """

    name, moves, writes, computes = "collect", True, True, True

    def __init__(
        self,
        poses: int | Array,
        safe_moves: SafeMoves,
        dt: float,
        *,
        settle_s: float = 1.0,
        record_s: float = 0.5,
        seed: int = 0,
    ) -> None:
        self._safe_moves, self._dt = safe_moves, dt
        self._stay = round(settle_s / dt), round(record_s / dt)
        #: In the order of the visits, beginning with one that a safe move reaches.
        self.poses = draw_poses(poses, safe_moves, seed) if isinstance(poses, int) else np.array(poses)
        self._next, self._begun = 0, 0
        self._move: Move | None = None

    def begin(self, joints: Array, ee: Array) -> None:
        # One after the other until one fits: this runs within a cycle.
        left = []
        for pose in self.poses:
            left.append(self._safe_moves.outside(joints, pose))
            if left[-1] == 0.0:
                break
        self.poses = np.roll(self.poses, -int(np.argmin(left)), axis=0)
        self._next, self._begun = 0, 0
        self._move = Move(joints, self.poses[0], self._safe_moves.limits, self._dt)

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        assert self._move is not None
        settle, record = self._stay
        if k - self._begun >= self._move.steps + settle + record:
            self._next += 1
            if self._next >= len(self.poses):
                return done("collect")
            self._move = Move(self.poses[self._next - 1], self.poses[self._next], self._safe_moves.limits, self._dt)
            self._begun = k
        since = k - self._begun - self._move.steps
        phase = "move" if since < 0 else "settle" if since < settle else "record"
        return Goal(f"{phase} {self._next + 1}", joints=self._move.at(k - self._begun + 1))
