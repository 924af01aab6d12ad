"""Any friction of a joint as linear columns, to be left out of a comparison of link torques.

In each direction a constant and a slope, a constant load, a share of the link torque (load-dependent friction), and the inertia
of a rotor that machine.toml does not state: masses do not depend on which friction is named.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Columns of the friction of a joint; the last is the acceleration, or zero where the inertia of the rotor is known.
FRICTION = 7
#: The column of a constant load.
CONSTANT = 4


def friction_columns(v: Array, a: Array, load: Array, known: bool = False) -> Array:
    """Columns for speed, acceleration and link torque, each (n,) → (n, 7); ``known``: whether the inertia of the rotor is."""
    forward, backward = (v > 0.0).astype(float), (v < 0.0).astype(float)
    rotor = np.zeros_like(a) if known else a
    return np.column_stack([forward, backward, v * forward, v * backward, np.ones_like(v), np.abs(load) * np.sign(v), rotor])


def without(table: Array, friction: Array) -> Array:
    """``table`` (m, k) less its least-squares fit by the columns of friction (m, 7)."""
    size = np.linalg.norm(friction, axis=0)
    q, r = np.linalg.qr(friction[:, size > 0.0] / size[size > 0.0])
    q = q[:, np.abs(np.diag(r)) > 1e-9]
    return np.asarray(table - q @ (q.T @ table))
