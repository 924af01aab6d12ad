"""The same plant in PyBullet: parallel worlds with the interface of the compiled chain, but slower.

The compiled chain moves the driven joints, rigid bodies the rest (:mod:`sysid.world`). PyBullet does not export its complete
state, so a run can be resumed exactly only at the beginning of an episode, which depends on the joints alone.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError
from sysid.plant import Plant
from sysid.plant.stepper import LaneState
from sysid.world import World, WorldState

Array = npt.NDArray[np.float64]


class Worlds:
    """``lanes`` worlds of one plant, with the methods of :class:`sysid.plant.stepper.Stepper` that an environment uses.

    Raises:
        SettingsError: PyBullet is missing, or the plant cannot be built there.
    """

    def __init__(self, plant: Plant, rate_hz: float, lanes: int = 1) -> None:
        self.lanes = lanes
        self._worlds = [World(plant, rate_hz) for _ in range(lanes)]
        axes = len(plant.machine.axes)
        self._out = LaneState(*(np.full((lanes, width), np.nan) for width in (axes, axes, axes, 3, 3)))
        self._begun_at = np.full((lanes, axes), np.nan)
        self._moved = np.zeros(lanes, dtype=np.bool_)

    def close(self) -> None:
        """Close PyBullet's clients."""
        for world in self._worlds:
            world.close()

    def reset(self, joints: npt.ArrayLike, *, which: npt.ArrayLike | None = None) -> LaneState:
        """Put all worlds, or those of a mask or indices, at rest at ``joints`` (A,) or (rows, A); the state of all."""
        lanes = np.arange(self.lanes) if which is None else np.arange(self.lanes)[np.asarray(which)]
        rows = np.broadcast_to(np.asarray(joints, dtype=np.float64), (len(lanes), self._begun_at.shape[1]))
        for lane, row in zip(lanes, rows, strict=True):
            self._keep(int(lane), self._worlds[lane].reset(row))
        self._begun_at[lanes], self._moved[lanes] = rows, False
        return self._state()

    def step(self, commands: npt.ArrayLike) -> LaneState:
        """Hold ``commands`` (lanes, A) for one step."""
        for lane, row in enumerate(np.asarray(commands, dtype=np.float64)):
            self._keep(lane, self._worlds[lane].step(row))
        self._moved[:] = True
        return self._state()

    def state(self) -> dict[str, Array]:
        """Joints at the beginning of the episodes.

        Raises:
            SettingsError: a world has moved since.
        """
        if self._moved.any():
            found = "the middle of an episode"
            raise SettingsError("PyBullet environment: state", found, "the beginning of one: only there it can be resumed")
        return {"begun_at": self._begun_at.copy()}

    def restore(self, state: Mapping[str, Array]) -> LaneState:
        """Begin the episodes of :meth:`state`."""
        return self.reset(state["begun_at"])

    def _keep(self, lane: int, state: WorldState) -> None:
        out = self._out
        out.drive[lane], out.joints[lane], out.structure[lane] = state.drive, state.joints, state.joints
        out.ee[lane], out.tool[lane] = state.ee, state.tool

    def _state(self) -> LaneState:
        out = self._out
        return LaneState(out.drive.copy(), out.joints.copy(), out.structure.copy(), out.ee.copy(), out.tool.copy())
