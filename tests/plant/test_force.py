"""The force at measured motion where the axis stands or turns round."""

from __future__ import annotations

import numpy as np
from plant_data import dataset_of, slide

from sysid.machine import KnownEffect
from sysid.plant import compile_plant, nominal_plant
from sysid.plant.force import force_inputs

FRICTION = 18.0


def test_dry_friction_explains_reversals_and_stops() -> None:
    """Where the filtered speed has no sign that could be trusted, the force says nothing for or against dry friction."""
    plant = nominal_plant(slide()).with_effect(KnownEffect("coulomb_friction", "slide", {"force": FRICTION}))
    model = compile_plant(plant)
    everywhere, moving = [], []
    for recording in dataset_of(plant, 30.0, seed=4).recordings:
        inputs = force_inputs(recording, slide().axis("slide"))
        assert 0.0 < inputs.rests.mean() < 0.9
        for errors, throughout in ((everywhere, True), (moving, False)):
            errors.append(inputs.model_force(model, model.theta[None], "slide", throughout)[0] - inputs.force)
    assert np.sqrt(np.mean(np.concatenate(moving) ** 2)) < 0.01 * FRICTION
    assert np.sqrt(np.mean(np.concatenate(everywhere) ** 2)) > 0.02 * FRICTION  # what that rule is for
