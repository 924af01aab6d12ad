"""``inertia_error``: the moving mass or inertia differs from the nominal one."""

from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

#: Largest ratio: a rotor that is described at the motor lacks the square of the gear ratio, up to a hundred.
MOST = 1e4

EFFECT = Effect(
    name="inertia_error",
    title="Wrong inertia",
    sentences=("The inertia of the {target} is {ratio} times what the simulation assumes.",),
    part="joint",
    stage="force",
    slots=(Slot("ratio", 1.0),),
    forms=(Form((Parameter("ratio", "1", (0.05, MOST), (0.7, 1.4), 0.01, "true inertia / nominal inertia"),)),),
    equation="M = ratio · inertia",
    source="definition",
    excited_by="acceleration that is large against friction",
    confused_with={"viscous_friction": "inertia is a force in phase with the acceleration, viscous friction with the speed"},
    need=Need("force_changes", 6, "Record {axis} with fast starts and stops, 20 s."),
    actuations=("force",),
    ratio_of="inertia",
)
