"""``stribeck_friction``: friction that is largest at rest and falls with speed as an oil film builds up."""

import math

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="stribeck_friction",
    title="Stribeck friction",
    sentences=("The friction of the {target} falls from {static_force} to {coulomb_force}.",),
    part="cylinder",
    stage="force",
    slots=(Slot("static_force"), Slot("coulomb_force"), Slot("stribeck_velocity", 0.01)),
    forms=(
        Form(
            (
                Parameter(
                    "static_force", "N or N·m", (0.0, 1e6), (1.0,), 0.01, "at rest, at least the Coulomb force", scale="force"
                ),
                Parameter("coulomb_force", "N or N·m", (0.0, 1e6), (0.5,), 0.01, "with a full film", scale="force"),
                Parameter(
                    "stribeck_velocity",
                    "drive/s",
                    (1e-5, 1.0),
                    (0.003, 0.01, 0.03),
                    0.05,
                    "63 % of the excess is gone",
                    secondary=True,
                ),
            )
        ),
    ),
    equation="f = (coulomb_force + (static_force − coulomb_force)·e^(−(v/stribeck_velocity)²))·sign(v)",
    source="Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30 (1994), §2.1",
    excited_by="slow motion in both directions, with starts from rest",
    confused_with={
        "coulomb_friction": "dry friction is constant over speed; Stribeck friction falls as motion begins",
        "viscous_friction": "Stribeck friction falls with speed; viscous friction rises",
    },
    example={"static_force": 2.0, "coulomb_force": 0.8, "stribeck_velocity": 0.05},
    need=Need("force_both_ways", 1, "Record {axis} at four speeds from creeping to full in both directions, 10 s each."),
    actuations=("force", "servo"),
    generalises=("coulomb_friction",),
)


@inlined
def magnitude(v, p, i):
    """Largest friction force at speed ``v`` [N or N·m]."""
    if p[i] == 0.0 and p[i + 1] == 0.0:
        return 0.0
    ratio = v / p[i + 2]
    return p[i + 1] + max(p[i] - p[i + 1], 0.0) * math.exp(-ratio * ratio)


@inlined
def force(v, p, i):
    """Force against the motion at speed ``v`` [N or N·m]."""
    return math.copysign(magnitude(v, p, i), v) if v != 0.0 else 0.0
