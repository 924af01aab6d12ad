"""``smooth_coulomb_friction``: dry friction whose sign changes gradually with the speed."""

import math

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

_FORCE = Parameter("force", "N or N·m", (0.0, 1e6), (1.0,), 0.01, "at high speed", scale="force")
_WIDTH = Parameter("width", "drive/s", (1e-4, 1.0), (0.03, 0.1), 0.005, "force over the slope at zero speed")

EFFECT = Effect(
    name="smooth_coulomb_friction",
    title="Smooth dry friction",
    sentences=(
        "Dry friction of {force}, reached over {width} with exponent {exponent}, acts against the motion of the {target}.",
        "Dry friction of {force}, reached over {width}, acts against the motion of the {target}.",
    ),
    part="cylinder",
    stage="force",
    slots=(Slot("force"), Slot("width", 0.05), Slot("exponent")),
    forms=(
        Form((_FORCE, _WIDTH)),
        Form(
            (
                _FORCE,
                _WIDTH,
                Parameter("exponent", "1", (1.0, 8.0), (1.5,), 0.1, "of the approach to the full force", secondary=True),
            )
        ),
    ),
    equation="f = F·tanh(x), or F·x/(1 + |x|^exponent)^(1/exponent) with an exponent; x = v/width",
    source="Andersson, Söderberg, Björklund, Tribology International 40 (2007), §2.2; Swevers et al., IEEE CSM 27 (2007)",
    excited_by="slow motion in both directions, at speeds below and above the width",
    confused_with={
        "coulomb_friction": "sharp friction is constant from the slowest motion on, smooth friction rises with the speed",
        "viscous_friction": "smooth friction is proportional to the speed at slow motion only; it saturates",
        "stribeck_friction": "smooth friction rises as motion begins, Stribeck friction falls",
    },
    example={"force": 1.5, "width": 0.1},
    need=Need("force_both_ways", 1, "Record {axis} at four speeds from creeping to full in both directions, 10 s each."),
    actuations=("force", "servo"),
    generalises=("coulomb_friction",),
    instead_of=("coulomb_friction", "stribeck_friction"),
)


@inlined
def slope(v, p, i):
    """Force over speed at ``v``, for an implicit step [N·s/m or N·m·s/rad]."""
    if p[i] == 0.0:
        return 0.0
    x = abs(v) / p[i + 1]
    if x < 1e-6:
        return p[i] / p[i + 1]
    if p[i + 2] > 0.0:
        return p[i] / p[i + 1] * (1.0 + x ** p[i + 2]) ** (-1.0 / p[i + 2])
    return p[i] / p[i + 1] * math.tanh(x) / x


@inlined
def force(v, p, i):
    """Force against the motion at speed ``v`` [N or N·m]."""
    return slope(v, p, i) * v
