"""``armature_error``: the rotor of a servo, as its joint feels it, has another inertia than the simulation assumes."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

#: Largest ratio: a rotor that is described at the motor lacks the square of the gear ratio, up to a hundred.
MOST = 1e4

EFFECT = Effect(
    name="armature_error",
    title="Wrong armature",
    sentences=("The armature of the {target} is {ratio} times what the simulation assumes.",),
    part="joint",
    stage="force",
    slots=(Slot("ratio", 1.0),),
    forms=(Form((Parameter("ratio", "1", (0.0, MOST), (0.5, 2.0, 5.0), 0.01, "true armature / described armature"),)),),
    equation="(M(q) + ratio·armature)·q̈ + … = force",
    source="rotor behind a gear: Siciliano et al., Robotics: Modelling, Planning and Control (2009), §7.1",
    excited_by="fast motion: steps of the command",
    confused_with={"viscous_friction": "armature acts with the acceleration, viscous friction with the speed"},
    need=Need("command_changes", 6, "Record {axis} with steps of several sizes, 20 s."),
    actuations=("servo",),
    ratio_of="inertia",
)


@inlined
def step(armature, p, i):
    """Described armature → true armature [kg·m² or kg]."""
    return p[i] * armature
