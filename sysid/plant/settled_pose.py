"""Static equilibrium of a compliant structure, compiled: every joint deflects under the gravity load of the deflected posture.

The posture q of the joints solves ``q = q₀ − C·L(q)``: q₀ the joints without sag, C their compliances, L the gravity loads. The
iteration ``q ← q₀ − C·L(q)`` multiplies the error by the largest eigenvalue of ``C·∂L/∂q``, the ratio of the stiffness of the
gravity loads to that of the joints (below 0.1 where a joint sags by less than 5°). An equilibrium exists near q₀ where this
ratio is below one. :data:`SETTLING` iterations are smooth in the parameters, with or without convergence.

Source: elastic joints under gravity: Siciliano et al., Robotics, 2009, §6.6; Khalil and Besnard, IEEE Trans. Robot. Autom. 18
(2002), 915–922.
"""

from __future__ import annotations

import numpy as np

from sysid.effects import joint_compliance
from sysid.effects.compiled import inlined, kernel
from sysid.plant.layout import AT, AXIS_WIDTH
from sysid.plant.pose import SCRATCH, pose

#: Iterations at most, and the change [rad or m] at which they end.
SETTLING, SETTLED = 20, 1e-13


@inlined
def settle(straight, p, links, base, q, scratch, tip, load):
    """Joints of the structure without sag (A,) → posture ``q`` (A,) under its own ``load`` (A,), and its ``tip`` (3,).

    ``scratch`` as of :func:`sysid.plant.pose.pose`.
    """
    for i in range(len(straight)):
        q[i] = straight[i]
        load[i] = 0.0
    for step in range(SETTLING + 1):
        moved = 0.0
        for i in range(len(straight)):
            place = joint_compliance.step(straight[i], p, i * AXIS_WIDTH + AT.joint_compliance_structure, load[i])
            moved = max(moved, abs(place - q[i]))
            q[i] = place
        if step > 0 and not moved > SETTLED:  # NaN ends it too
            break
        pose(q, p, links, base, scratch, tip, load)


@kernel
def settled_loads(p, links, base, straight, out):
    """Gravity loads (n, A) of the deflected postures of joints without sag (n, A)."""
    q, tip, scratch = np.empty(straight.shape[1]), np.empty(3), np.empty((len(links), SCRATCH))
    for k in range(len(straight)):
        settle(straight[k], p, links, base, q, scratch, tip, out[k])
