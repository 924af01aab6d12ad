"""``force_limit``: the controller of a servo makes no larger force."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

#: Start values in units of the typical force: a limit acts in large motions alone.
STARTS = (4.0, 12.0, 36.0)
#: Without a limit [N or N·m].
ABSENT = 1e9

EFFECT = Effect(
    name="force_limit",
    title="Force limit of the servo",
    sentences=("The servo of the {target} makes a force of {limit} at most.",),
    part="valve",
    stage="command",
    slots=(Slot("limit", ABSENT),),
    forms=(Form((Parameter("limit", "N or N·m", (1e-6, ABSENT), STARTS, 0.01, "largest magnitude", scale="force"),)),),
    equation="force = clip(kp·(command − q) − kv·q̇, −limit, limit)",
    source="position servo of a simulator: MuJoCo 3, XML Reference, actuator forcerange",
    excited_by="steps of the command that are large enough for the limit",
    confused_with={
        "armature_error": "a limit slows large steps only, armature small ones too",
        "damping_error": "a limit slows large steps only, damping small ones too",
    },
    example={"limit": 2.0},
    need=Need("command_changes", 6, "Record {axis} with large and small steps, 20 s."),
    actuations=("servo",),
    exempt=("memoryless",),
)


@inlined
def lowest(described, p, i):
    """Lowest force of the controller [N·m or N]; a limit of the plant takes the place of the described one."""
    return described if p[i] >= ABSENT else -p[i]


@inlined
def highest(described, p, i):
    """Highest force of the controller [N·m or N]."""
    return described if p[i] >= ABSENT else p[i]
