"""``base_misalignment``: the frame of the position measurement is not where it was surveyed to be."""

from __future__ import annotations

from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

_T = ("translation_x", "translation_y", "translation_z")
_R = ("rotation_x", "rotation_y", "rotation_z")

EFFECT = Effect(
    name="base_misalignment",
    stage="end_effector",
    target="base",
    slots=tuple(Slot(name) for name in (*_T, *_R)),
    forms=(
        Form(
            (
                Parameter("translation", "m", (-1.0, 1.0), (0.0,), 1e-3, "shift", sets=tuple((name,) for name in _T)),
                Parameter("rotation", "rad", (-0.5, 0.5), (0.0,), 1e-3, "rotation vector", sets=tuple((name,) for name in _R)),
            )
        ),
    ),
    equation="x_measured = R(rotation)·x_model + translation",
    source="Hollerbach & Wampler, The calibration index, IJRR 15 (1996)",
    excited_by="poses spread over the work space",
    confused_with=("joint_offset", "link_length_error"),
    need=Need("joint_coverage", 10, "Record poses over the whole work space."),
)
