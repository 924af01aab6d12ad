"""The force at measured motion where the axis stands or turns round."""

from __future__ import annotations

import numpy as np
import pandas as pd
from plant_data import dataset_of, slide

from sysid.datasets import Recording
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


def test_a_speed_within_its_noise_has_no_certain_sign() -> None:
    """An encoder's noise, differentiated, decides how much of a slow motion is left to the measured force."""
    time = np.arange(5000) / 500.0
    position = 0.05 * np.sin(2 * np.pi * 0.2 * time)
    shares = []
    for noise in (0.0, 2e-5, 2e-4):
        table = {"time": time, "slide.command": np.ones(5000), "slide.joint": position}
        table["slide.joint"] = position + noise * np.random.default_rng(0).standard_normal(5000)
        shares.append(force_inputs(Recording("slow", pd.DataFrame(table), 500.0), slide().axis("slide")).rests.mean())
    assert shares[0] < 0.03
    assert shares[0] < shares[1] < 0.1 < shares[2] < 0.9
