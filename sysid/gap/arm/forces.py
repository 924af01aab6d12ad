"""Forces of all force axes of an arm at measured motion, on common rows and without the friction of the joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.arm.friction import friction_columns, without
from sysid.machine import Axis
from sysid.plant import Model
from sysid.plant.force import ForceInputs, force_inputs
from sysid.plant.link_torque import link_torque

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]


class ArmForces:
    """The output of the links stage: measured and predicted forces, each less its least-squares fit by any friction.

    Args:
        axes: force axes; ``recordings``: in which all of them are compared.
    """

    def __init__(self, model: Model, axes: Sequence[Axis], recordings: Sequence[Recording]) -> None:
        self.model, self.axes = model, tuple(axes)
        self._known = {r.name: (r, [force_inputs(r, axis) for axis in axes]) for r in recordings}
        self._friction: dict[str, list[Array]] = {}

    @property
    def names(self) -> frozenset[str]:
        return frozenset(self._known)

    def rows(self, recording: Recording) -> Rows:
        """Rows on which some axis is compared, (n,)."""
        return np.unique(np.concatenate([own.rows for own in self._known[recording.name][1]]))

    def measured(self, recording: Recording) -> Array:
        """(n, d); NaN where an axis rests."""
        return np.asarray(self._on_common(recording, lambda own, axis: own.force[None])[0])

    def predicted(self, thetas: Array, recording: Recording) -> Array:
        """(lanes, n, d)."""
        return self._on_common(recording, lambda own, axis: own.model_force(self.model, thetas, axis.name))

    def inputs(self, recording: Recording) -> list[ForceInputs]:
        """Of each axis; a changed copy of a known recording (with noise added) is filtered on the same rows."""
        original, inputs = self._known[recording.name]
        if recording is original:
            return inputs
        return [force_inputs(recording, axis, rows=own.rows) for axis, own in zip(self.axes, inputs, strict=True)]

    def _on_common(self, recording: Recording, forces: Callable[[ForceInputs, Axis], Array]) -> Array:
        """Forces (lanes, m) of each axis, without friction, on the common rows: (lanes, n, d)."""
        there, frictions = self.rows(recording), self._frictions(recording)
        parts = [forces(own, axis) for own, axis in zip(self.inputs(recording), self.axes, strict=True)]
        out = np.full((len(parts[0]), len(there), len(self.axes)), np.nan)
        for j, (part, friction) in enumerate(zip(parts, frictions, strict=True)):
            own = self._known[recording.name][1][j]
            out[:, np.searchsorted(there, own.rows), j] = without(part.T, friction).T
        return out

    def _frictions(self, recording: Recording) -> list[Array]:
        """Filtered columns of friction of each axis, (m, 7), at the motion of the original recording."""
        if recording.name not in self._friction:
            original, inputs = self._known[recording.name]
            found = []
            for own, axis in zip(inputs, self.axes, strict=True):
                load = link_torque(self.model, self.model.theta, original, axis.name).carried
                columns = friction_columns(own.speed, own.acceleration, load, axis.inertia is not None)
                found.append(own.compared(columns))
            self._friction[recording.name] = found
        return self._friction[recording.name]
