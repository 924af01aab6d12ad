"""``tip_offset``: the measured point lies elsewhere on the last link than described."""

from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

_T = ("translation_x", "translation_y", "translation_z")

EFFECT = Effect(
    name="tip_offset",
    title="Tip offset",
    sentences=("The measured point lies {translation} from its described place on the last link.",),
    part="link",
    stage="end_effector",
    target="ee",
    slots=tuple(Slot(name) for name in _T),
    forms=(
        Form(
            (
                Parameter(
                    "translation",
                    "m",
                    (-10.0, 10.0),
                    (0.0,),
                    1e-3,
                    "shift in the frame of the link that the last joint moves",
                    sets=tuple((name,) for name in _T),
                ),
            )
        ),
    ),
    equation="x = x_nominal + R_last(q)·translation, R_last the orientation of the link that the last joint moves",
    source="Hollerbach & Wampler, The calibration index, IJRR 15 (1996)",
    excited_by="poses that turn the last joints",
    confused_with={
        "link_length_error": "the length of the last link is the part of the offset along it",
        "joint_offset": "an offset of the last joint moves the point along its circle only",
        "base_misalignment": "a misalignment is fixed in space; an offset of the point turns with the last link",
    },
    example={"translation": [0.1, 0.0, 0.15]},
    described_only=True,
    need=Need("joint_coverage", 10, "Record poses that turn every joint, the last ones above all."),
)
