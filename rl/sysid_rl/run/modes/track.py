"""Follow a path, or a target from datagrams, with the end effector."""

from __future__ import annotations

import math
import socket

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid_rl.control.input_shaper import InputShaper
from sysid_rl.run.limits import Limits
from sysid_rl.run.modes.mode import Approach, Goal, done
from sysid_rl.train.paths import Path, eased

Array = npt.NDArray[np.float64]

#: Time for which the last point is held [s].
LINGER_S = 0.5


class TrackPath:
    """Move to the beginning of the path in joint space, and follow it.

    Args:
        path: in the base frame.
        start: joints (A,) at its beginning.
        limits, dt: of the machine.
        ahead: look-ahead of the policy in cycles.
        ease_s: duration of the speed ramps.
        laps: number of rounds; an open path is followed forth and back.
        settle_s, aside: of the :class:`~sysid_rl.run.modes.mode.Approach`.
        shaper: of the setpoints, against the swing of a hanging tool; its mean delay is compensated.
    """

    name, moves, writes, computes = "track", True, True, True

    def __init__(
        self,
        path: Path,
        start: Array,
        limits: Limits,
        dt: float,
        *,
        ahead: int = 0,
        ease_s: float = 1.0,
        laps: int = 1,
        shaper: InputShaper | None = None,
        settle_s: float = 0.5,
        aside: Array | None = None,
    ) -> None:
        once = eased(path, ease_s)
        closed = float(np.linalg.norm(path.points[-1] - path.points[0])) < 1e-3
        rounds = [once if closed or k % 2 == 0 else once[::-1] for k in range(laps)]
        late = 0 if shaper is None else round(shaper.delay / dt)
        # The target rests during the look-ahead.
        self.points = np.concatenate([np.tile(once[0], (ahead + late, 1)), *rounds])
        self.ahead = ahead + late
        self._linger = round((LINGER_S + (0.0 if shaper is None else shaper.times[-1])) / dt)
        self._approach = Approach(start, limits, dt, settle_s, aside)

    def begin(self, joints: Array, ee: Array) -> None:
        self._approach.begin(joints)

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        first = self._approach.steps
        if k < first:
            return self._approach.goal(k)
        here = k - first
        last = len(self.points) - 1
        if here > last + self._linger:
            return done("track")
        target, aim = (self.points[min(here + 1 + ahead, last)] for ahead in (0, self.ahead))
        return Goal("track", target=target, aim=aim)


class TrackLive:
    """Follow a target ``x y z`` [m] from datagrams on the loopback, the newest one.

    The target moves at most at ``speed``; without a datagram it stays at the end effector's initial position.

    Args:
        port: on 127.0.0.1.
        speed: greatest speed of the target [m/s].
        dt: of a cycle.
        seconds: duration of the run; None: unlimited.

    Raises:
        SettingsError: the port is taken.
    """

    name, moves, writes, computes = "track", True, True, True

    def __init__(self, port: int, speed: float, dt: float, seconds: float | None = None) -> None:
        self._step, self._last = speed * dt, math.inf if seconds is None else seconds / dt
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(("127.0.0.1", port))
        except OSError as error:
            self._socket.close()
            raise SettingsError("track.live_port", f"{port}: {error.strerror}", "a free port on the loopback") from None
        self.port: int = self._socket.getsockname()[1]
        self._wanted, self._target = np.full(3, np.nan), np.full(3, np.nan)

    def begin(self, joints: Array, ee: Array) -> None:
        self._wanted, self._target = ee.copy(), ee.copy()

    def goal(self, k: int, joints: Array, ee: Array) -> Goal:
        if k >= self._last:
            return done("track")
        self._listen()
        way = self._wanted - self._target
        length = float(np.linalg.norm(way))
        self._target = self._wanted.copy() if length <= self._step else self._target + way * (self._step / length)
        return Goal("live", target=self._target.copy(), aim=self._target.copy())

    def close(self) -> None:
        self._socket.close()

    def _listen(self) -> None:
        for _ in range(16):  # a flood of datagrams may not delay the loop
            try:
                text = self._socket.recv(256)
            except BlockingIOError:
                return
            try:
                point = np.array([float(part) for part in text.decode("ascii").replace(",", " ").split()])
            except ValueError:
                continue  # not a point: keep the last one
            if point.shape == (3,) and np.isfinite(point).all():
                self._wanted = point
