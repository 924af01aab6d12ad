"""``load_dependent_friction``: dry friction that grows with the torque that the transmission carries.

The load is the torque of the links on the joint by gravity and acceleration, without the inertia of the rotor, which is ahead
of the transmission. Where a transmission loses a share c₁ of the load as it drives it and a share c₂ as it is driven by it, its
friction is ½(c₁ + c₂)·|load|·sign(v) + ½(c₁ − c₂)·load: the first term is this effect, and the second one is the same as an
error of the torque constant or of all masses (``scale`` of :mod:`sysid.effects.inertial_error`).
"""

import math

from sysid.effects import smooth_coulomb_friction
from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="load_dependent_friction",
    title="Load-dependent friction",
    sentences=("Dry friction of {coefficient} times the torque of the links acts against the motion of the {target}.",),
    part="joint",
    stage="force",
    slots=(Slot("coefficient"),),
    forms=(
        Form(
            (Parameter("coefficient", "1", (0.0, 1.0), (0.05, 0.15), 0.001, "friction per torque of the links on the joint"),)
        ),
    ),
    equation="f = coefficient·|load|·sign(v); with the width of smooth_coulomb_friction where that acts too",
    source="Hamon, Gautier, Garrec, IEEE/RSJ IROS 2010; Bittencourt, Gunnarsson, J. Dyn. Syst. Meas. Control 134 (2012)",
    excited_by="motion in both directions at postures with little and with much weight",
    confused_with={
        "coulomb_friction": "dry friction is the same at every posture, load-dependent friction rises with the weight",
        "link_mass_error": "the torque of a mass has the same sign in both directions of motion, friction changes it",
    },
    example={"coefficient": 0.2},
    need=Need(
        "weight_change",
        20,
        "Record {axis} slowly in both directions where its weight is small and where it is large, 20 s each.",
    ),
    actuations=("force",),
    of_links=True,
)


@inlined
def force(v, load, p, i, smooth):
    """Force against the motion at speed ``v`` under the torque ``load`` of the links [N or N·m].

    ``smooth``: index of :mod:`sysid.effects.smooth_coulomb_friction`, whose direction it has where that acts.
    """
    if p[i] == 0.0 or v == 0.0:
        return 0.0
    if p[smooth] > 0.0:
        return p[i] * abs(load) * smooth_coulomb_friction.force(v, p, smooth) / p[smooth]
    return math.copysign(p[i] * abs(load), v)
