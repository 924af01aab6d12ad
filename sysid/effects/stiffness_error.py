"""``stiffness_error``: the controller of a servo makes another force of its position error than the simulation assumes."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="stiffness_error",
    title="Wrong servo stiffness",
    sentences=("The servo of the {target} is {ratio} times as stiff as described.",),
    part="valve",
    stage="command",
    slots=(Slot("ratio", 1.0),),
    forms=(Form((Parameter("ratio", "1", (0.05, 20.0), (0.7, 1.4), 0.01, "true kp / described kp"),)),),
    equation="force = clip(ratio·kp·(command − q) − kv·q̇)",
    source="position servo of a simulator: MuJoCo 3, XML Reference, actuator/position",
    excited_by="fast motion, and rest in postures that load the joint",
    confused_with={
        "damping_error": "stiffness acts on the error of the position, damping on the speed",
        "armature_error": "stiffness holds a load at rest as well, armature acts with the acceleration only",
        "coulomb_friction": "stiffness scales every error of the position, dry friction leaves one of constant size",
        "force_limit": "stiffness acts in small motions too, a limit only in large ones",
    },
    need=Need("command_changes", 6, "Record {axis} with steps of several sizes, 20 s."),
    actuations=("servo",),
    exempt=("memoryless",),
)


@inlined
def step(kp, p, i):
    """Described stiffness → true stiffness [N·m/rad or N/m]."""
    return p[i] * kp
