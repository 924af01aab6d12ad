"""``link_length_error``: a link is longer or shorter than in the URDF."""

from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

EFFECT = Effect(
    name="link_length_error",
    title="Link length error",
    sentences=("The link moved by the {target} is {error} longer than described.",),
    part="link",
    stage="end_effector",
    slots=(Slot("error"),),
    forms=(Form((Parameter("error", "m", (-0.5, 0.5), (-0.02, 0.02), 5e-4, "true length − URDF length"),)),),
    equation="the link that the axis moves is longer by error along the line to the next joint (or the tip)",
    source="Khalil & Dombre 2002, ch. 11",
    excited_by="poses spread over the work space",
    confused_with={"joint_offset": "an offset is tangential and grows with reach; a length error is radial"},
    example={"error": 0.08},
    need=Need("joint_coverage", 10, "Record poses over the whole range of {axis}."),
    actuations=("velocity", "position", "force", "servo"),
)
