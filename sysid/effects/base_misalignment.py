"""``base_misalignment``: the frame of the position measurement differs from its surveyed position."""

import math

from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

_T = ("translation_x", "translation_y", "translation_z")
_R = ("rotation_x", "rotation_y", "rotation_z")

EFFECT = Effect(
    name="base_misalignment",
    title="Base misalignment",
    sentences=("The frame of the measurement differs from that of the base: shift {translation}, rotation {rotation}.",),
    part="base",
    stage="end_effector",
    target="base",
    slots=tuple(Slot(name) for name in (*_T, *_R)),
    forms=(
        Form(
            (
                Parameter("translation", "m", (-100.0, 100.0), (0.0,), 1e-3, "shift", sets=tuple((name,) for name in _T)),
                Parameter(
                    "rotation", "rad", (-math.pi, math.pi), (0.0,), 1e-3, "rotation vector", sets=tuple((name,) for name in _R)
                ),
            )
        ),
    ),
    equation="x_measured = R(rotation)·x_model + translation",
    source="Hollerbach & Wampler, The calibration index, IJRR 15 (1996)",
    excited_by="poses spread over the work space",
    confused_with={
        "joint_offset": "a misalignment is sinusoidal in slew; an offset is tangential and grows with reach",
        "link_length_error": "a misalignment is fixed in space; a length error follows the link",
    },
    example={"translation": [0.05, 0.0, 0.04], "rotation": [0.0, 0.06, 0.0]},
    need=Need("joint_coverage", 10, "Record poses over the whole work space."),
)
