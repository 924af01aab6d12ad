"""The cylinder controller: joint setpoints and measured positions → valve commands, a step at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, SettingsError
from sysid.plant import Plant
from sysid.plant.plant import LINKAGE
from sysid_rl.control.law import LAST, RING, command, fill, look_up, ring_size
from sysid_rl.control.tuning import AxisTuning, tune

Array = npt.NDArray[np.float64]

#: Points of the tables joint → cylinder.
_POINTS = 2048
#: Largest preview [s].
MAX_PREVIEW = 5.0


class CylinderController:
    """``copies`` of one controller, for one machine or thousands of simulated ones.

    Args:
        plant: its linkages map joint setpoints to cylinder positions; its effects tune the controller.
        tuning: of each axis; default: :func:`sysid_rl.control.tune`.
        preview: time from the end of a step to that of its setpoint [s]; zero: the setpoint is for the next sample.

    Raises:
        SettingsError: a cylinder without linkage, a force axis, a preview out of range, no copy.
    """

    def __init__(
        self,
        plant: Plant,
        tuning: Sequence[AxisTuning] | None = None,
        *,
        copies: int = 1,
        preview: float = 0.0,
    ) -> None:
        where = f"cylinder controller of {plant.machine.name}"
        if copies < 1:
            raise SettingsError(where, f"{copies} copies", "at least one")
        if not 0.0 <= preview <= MAX_PREVIEW:
            raise SettingsError(where, f"preview = {preview} s", f"0 to {MAX_PREVIEW:g} s")
        self.plant, self.copies, self.preview = plant, copies, preview
        self.tuning = tuple(tuning) if tuning is not None else tune(plant)
        self.dt = 1.0 / plant.machine.rate_hz
        axes = len(plant.machine.axes)
        if len(self.tuning) != axes:
            raise SettingsError(where, f"tuning of {len(self.tuning)} axes", f"{axes}")
        self._parameters = np.array([item.row() for item in self.tuning])
        self._tables, self._starts, self._steps = _tables(plant, where)
        self._state = np.full((copies, axes, RING + ring_size(preview, self.dt)), np.nan)
        #: Which axes are measured as a cylinder; the others as a joint.
        self.cylinders = np.array([axis.drives == "cylinder" for axis in plant.machine.axes])

    def drive(self, joints: npt.ArrayLike) -> Array:
        """Driven coordinate (cylinder or joint), (n, A), at joints (n, A)."""
        rows = np.ascontiguousarray(np.atleast_2d(np.asarray(joints, dtype=np.float64)))
        out = np.empty_like(rows)
        look_up(self._tables, self._starts, self._steps, rows, out)
        return out

    def reset(self, measured: npt.ArrayLike, which: npt.ArrayLike | None = None) -> None:
        """Set to rest at the driven coordinates ``measured``, (A,) or (rows, A): all copies, or those of a mask or indices."""
        lanes = np.arange(self.copies) if which is None else np.arange(self.copies)[np.asarray(which)]
        rows = np.broadcast_to(np.asarray(measured, dtype=np.float64), (len(lanes), len(self.tuning)))
        fill(self._parameters, self._state, lanes, np.ascontiguousarray(rows))

    def commands(self, setpoints: npt.ArrayLike, measured: npt.ArrayLike) -> Array:
        """Valve commands for the next step.

        Args:
            setpoints: joints (A,) or (n, A) [rad or m].
            measured: driven coordinates now, cylinder [m] or joint [rad or m], of the same shape.

        Returns:
            Commands in [-1, 1], (n, A); positions for servo axes.

        Raises:
            InputError: another shape, a number that is not finite, or a copy that was not reset.
        """
        shape = self.copies, len(self.tuning)
        wanted, seen = (np.atleast_2d(np.asarray(values, dtype=np.float64)) for values in (setpoints, measured))
        for name, values in (("setpoints", wanted), ("measured", seen)):
            if values.shape != shape:
                raise InputError("cylinder controller", f"{name} of shape {values.shape}", f"{shape}")
            if not np.isfinite(values).all():
                raise InputError("cylinder controller", f"{name} with a value that is not finite", "numbers [rad or m]")
        if np.isnan(self._state[:, 0, 0]).any():
            raise InputError("cylinder controller", "a copy was never reset", "reset(measured) before the first step")
        out = np.empty(shape)
        command(self._parameters, self._state, self.drive(wanted), np.ascontiguousarray(seen), self.preview, self.dt, out)
        return out

    @property
    def last(self) -> Array:
        """The last commands, (n, A)."""
        return self._state[:, :, LAST].copy()

    def override(self, commands: npt.ArrayLike) -> None:
        """Replace the last commands by those that were sent, (A,) or (n, A), as after a command filter."""
        self._state[:, :, LAST] = np.asarray(commands, dtype=np.float64)

    def state(self) -> dict[str, Any]:
        """State of the controller."""
        return {"controller": self._state.copy()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a :meth:`state`, exactly.

        Raises:
            InputError: a state of another shape.
        """
        kept = np.asarray(state["controller"], dtype=np.float64)
        if kept.shape != self._state.shape:
            raise InputError("cylinder controller", f"a state of shape {kept.shape}", f"one of shape {self._state.shape}")
        self._state[:] = kept


def _tables(plant: Plant, where: str) -> tuple[Array, Array, Array]:
    """Cylinder over an even grid of the joint, (A, points), first joint and step of the grid; NaN steps for joint axes."""
    axes = plant.machine.axes
    tables, starts, steps = np.zeros((len(axes), _POINTS)), np.zeros(len(axes)), np.full(len(axes), np.nan)
    for i, axis in enumerate(axes):
        if axis.drives != "cylinder":
            continue
        if axis.name not in plant.linkages:
            raise SettingsError(where, f"axis {axis.name} has no linkage", LINKAGE)
        linkage = plant.linkages[axis.name]
        first, last = float(linkage.joints.min()), float(linkage.joints.max())
        starts[i], steps[i] = first, (last - first) / (_POINTS - 1)
        tables[i] = linkage.displacement(np.linspace(first, last, _POINTS))
    return tables, starts, steps
