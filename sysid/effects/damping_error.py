"""``damping_error``: the controller of a servo brakes the speed by another gain than the simulation assumes."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="damping_error",
    title="Wrong servo damping",
    sentences=("The servo of the {target} damps its speed {ratio} times as much as described.",),
    part="valve",
    stage="command",
    slots=(Slot("ratio", 1.0),),
    forms=(Form((Parameter("ratio", "1", (0.0, 20.0), (0.7, 1.4), 0.01, "true kv / described kv"),)),),
    equation="force = clip(kp·(command − q) − ratio·kv·q̇)",
    source="position servo of a simulator: MuJoCo 3, XML Reference, actuator/position",
    excited_by="fast motion: steps of the command",
    confused_with={
        "viscous_friction": "both brake in proportion to the speed; the damping of the servo counts towards its force limit, "
        "viscous friction does not: only motion at the limit separates them",
        "armature_error": "damping acts with the speed, armature with the acceleration",
    },
    need=Need("command_changes", 6, "Record {axis} with steps of several sizes, 20 s."),
    actuations=("servo",),
    ratio_of="damping",
    exempt=("memoryless",),
)


@inlined
def step(kv, p, i):
    """Described damping → true damping [N·m·s/rad or N·s/m]."""
    return p[i] * kv
