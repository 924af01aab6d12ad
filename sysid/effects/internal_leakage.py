"""``internal_leakage``: oil leaks past piston and spool; the axis creeps with the valve closed."""

from sysid.effects.compiled import inlined
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="internal_leakage",
    title="Internal leakage",
    titles={"unknown": "Creep at zero command"},
    sentences=("With its valve closed the {target} creeps at {rate}.",),
    sentences_by={"unknown": ("At zero command the {target} creeps at {rate}.",)},
    part="cylinder",
    stage="command",
    slots=(Slot("rate"),),
    forms=(Form((Parameter("rate", "drive/s", (-0.05, 0.05), (-3e-4, 3e-4), 3e-6, "speed lost, at any command"),)),),
    equation="v = speed − rate",
    source="Merritt 1967, §5.3; 0.01–0.2 mm/s (machine facts)",
    excited_by="rest under load for tens of seconds",
    confused_with={"load_dependent_flow": "leakage acts at zero command; load-dependent flow needs flow"},
    example={"rate": 0.05},
    need=Need("rest", 10, "Leave {axis} at rest under load for 60 s."),
    actuations=("velocity",),
)


@inlined
def step(v, p, i):
    """``v`` is the speed in units of the drive."""
    return v - p[i]
