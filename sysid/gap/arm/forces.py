"""Forces of all force axes of an arm at measured motion, on common rows and without the friction of the joints.

Any friction of a joint is a sum of linear columns, to be left out of a comparison of link torques: in each direction a constant
and a slope, a constant load, a share of the link torque (load-dependent friction), and the inertia of a rotor that machine.toml
does not state. Masses do not depend on which friction is named.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.machine import Axis
from sysid.plant import Model
from sysid.plant.force import ForceInputs, force_inputs
from sysid.plant.link_torque import link_torque

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]

#: Columns of the friction of a joint; the last is the acceleration, or zero where the inertia of the rotor is known.
FRICTION = 7
#: The column of a constant load.
CONSTANT = 4
#: Rows for each column of a regression at least.
ROWS_PER_COLUMN = 4


def friction_columns(v: Array, a: Array, load: Array, known: bool = False) -> Array:
    """Columns for speed, acceleration and link torque, each (n,) → (n, 7); ``known``: whether the inertia of the rotor is."""
    forward, backward = (v > 0.0).astype(float), (v < 0.0).astype(float)
    rotor = np.zeros_like(a) if known else a
    return np.column_stack([forward, backward, v * forward, v * backward, np.ones_like(v), np.abs(load) * np.sign(v), rotor])


def axis_friction(inputs: ForceInputs, axis: Axis, load: Array) -> Array:
    """The same for the motion of an axis under the torque of its links (n,): (n, 7)."""
    return friction_columns(inputs.speed, inputs.acceleration, load, axis.inertia is not None)


def without(table: Array, friction: Array) -> Array:
    """``table`` (m, k) less its least-squares fit by the columns of friction (m, 7)."""
    size = np.linalg.norm(friction, axis=0)
    q, r = np.linalg.qr(friction[:, size > 0.0] / size[size > 0.0])
    q = q[:, np.abs(np.diag(r)) > 1e-9]
    return np.asarray(table - q @ (q.T @ table))


def fitted(columns: Array, target: Array) -> tuple[Array, float]:
    """Coefficients (k,) of a least-squares fit by columns (m, k) of any size, and the RMS that it leaves of ``target`` (m,).

    The RMS counts degrees of freedom.
    """
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    found, _, rank, _ = np.linalg.lstsq(columns / size, target, rcond=1e-9)
    left = target - columns / size @ found
    return found / size, float(np.sqrt(left @ left / max(len(target) - int(rank), 1)))


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
        there, kept = self.rows(recording), [own.rows for own in self._known[recording.name][1]]
        parts = [forces(own, axis) for own, axis in zip(self.inputs(recording), self.axes, strict=True)]
        out = np.full((len(parts[0]), len(there), len(self.axes)), np.nan)
        for j, (part, friction) in enumerate(zip(parts, self._frictions(recording), strict=True)):
            out[:, np.searchsorted(there, kept[j]), j] = without(part.T, friction).T
        return out

    def _frictions(self, recording: Recording) -> list[Array]:
        """Filtered columns of friction of each axis, (m, 7), at the motion of the original recording."""
        if recording.name not in self._friction:
            original, inputs = self._known[recording.name]
            self._friction[recording.name] = [
                own.compared(axis_friction(own, axis, link_torque(self.model, self.model.theta, original, axis.name).carried))
                for own, axis in zip(inputs, self.axes, strict=True)
            ]
        return self._friction[recording.name]
