"""Effects that change every speed by one share, and those that do not."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from plant_data import loaded_arm, nominal

from sysid.datasets.recording import Recording
from sysid.effects.catalogue import CATALOGUE
from sysid.effects.effect import Effect
from sysid.machine import KnownEffect
from sysid.plant import free_run

#: Parts of a valve without memory, and the drift of its gain. The share of a load depends on the load, which goes with the
#: place and so, in a recording, with the speed; its form, linear in the pressure, is an idealisation.
OF_THE_VALVE = [
    effect
    for effect in CATALOGUE
    if effect.stage == "command"
    and effect.target == "axis"
    and effect.actuations != ("servo",)
    and effect.name != "load_dependent_flow"
    and (effect.memory(0.01) == 0 or effect.proportional)
]


def change(effect: Effect, command: float) -> float:
    """Relative change of the boom's speed by an effect during a short motion from one place."""
    time = np.arange(40) / 100.0
    table = pd.DataFrame({"time": time, "boom.command": command, "slew.command": 0.0, "wrist.command": 0.0})
    start = np.where(time < 0.01, 0.06, np.nan)
    recording = Recording("short", table.assign(**{"boom.cylinder": start}), 100.0)
    form = effect.forms[0]
    values = effect.example or {p.name: p.starts[0] for p in form.parameters}
    made = [
        free_run(nominal(*known, machine=loaded_arm()), recording)["boom.cylinder"].to_numpy()
        for known in ((), (KnownEffect(effect.name, "boom", values),))
    ]
    without, within = (float(run[-1] - run[0]) for run in made)
    return within / without - 1.0


@pytest.mark.parametrize("effect", OF_THE_VALVE, ids=lambda effect: effect.name)
def test_a_proportional_effect_changes_slow_and_fast_motion_by_one_share(effect: Effect) -> None:
    slow, fast = change(effect, -0.3), change(effect, -0.9)
    assert abs(slow) > 1e-4 or abs(fast) > 1e-4
    assert (abs(slow - fast) < 0.05 * abs(fast)) is effect.proportional


def test_gains_are_proportional() -> None:
    assert {e.name for e in CATALOGUE if e.proportional} == {
        "gain_error", "asymmetric_gain", "temperature_drift"
    }  # fmt: skip
