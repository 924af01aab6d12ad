"""``joint_offset``: the zero of a joint sensor differs from that of the model."""

from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="joint_offset",
    title="Joint zero offset",
    sentences=("The zero of the {target} joint is off by {offset}.",),
    part="joint",
    stage="end_effector",
    slots=(Slot("offset"),),
    forms=(Form((Parameter("offset", "joint", (-0.5, 0.5), (-0.02, 0.02), 2e-4, "true joint − measured joint"),)),),
    equation="q_true = q_measured + offset",
    source="Khalil & Dombre, Modeling, Identification and Control of Robots, 2002, ch. 11",
    excited_by="poses spread over the work space",
    confused_with={"joint_compliance": "sag changes with the gravity moment; an offset is constant"},
    example={"offset": 0.1},
    need=Need("joint_coverage", 10, "Record poses over the whole range of {axis}."),
    actuations=("velocity", "position", "force", "servo"),
)
