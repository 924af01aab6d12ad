"""The proof takes names away again, together with what they leaned on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plant_data import dataset_of, nominal

from sysid.gap.candidates import as_nuisance
from sysid.gap.case import open_case, stage_candidates
from sysid.gap.data import Data
from sysid.gap.evidence import Comparison
from sysid.gap.finding import Finding, Kept
from sysid.gap.fit import fit_candidates, place
from sysid.gap.prove import judge
from sysid.machine import KnownEffect


@pytest.mark.parametrize(("leeway", "named"), [(2.5, False), (1.0, True)])
def test_a_gain_that_departed_beside_a_dropped_effect_alone_gets_no_name(leeway: float, named: bool) -> None:
    """The axis is 2 % faster than the simulation says; the search believed in a side that is 6 % faster and a slower one."""
    plant = nominal()
    true = plant.with_effect(KnownEffect("gain_error", "slew", {"ratio": 1.02}))
    case, stages = open_case(dataset_of(true, 14.0, seed=5), plant, 0)
    stage = next(s for s in stages if s.label == "command stage of slew")
    offered = {c.effect.name: c for c in reversed(stage_candidates(case, stage)) if c.form is c.effect.forms[0]}
    gain, asymmetry = as_nuisance(offered["gain_error"]), offered["asymmetric_gain"]
    believed = np.array([1.06, 0.93])
    unknowns = (*gain.unknowns, *asymmetry.unknowns)
    seen = Data(stage.problem, stage.split.seen, stage.sigma)
    fit = fit_candidates(seen, case.theta, (gain, asymmetry), [believed])
    fit = replace(fit, values=believed, theta=place(case.theta, unknowns, believed[None])[0])
    certain = Comparison(delta_bic=100.0, gain=50.0, p_value=0.001, ratio=1.9)
    found = Finding(stage.problem, (Kept(gain, certain), Kept(asymmetry, certain)), (), fit, 9.0, 5.0, leeway=leeway)
    outcome = judge(case, [replace(stage, finding=found)])
    assert any("asymmetric_gain on slew fits, but predicts held-out recordings hardly better" in n for n in outcome.notes)
    assert [effect.name for effect in outcome.named] == ["gain_error"] * named
    assert any("gain_error on slew adjusted" in note for note in outcome.notes) != named
    (ratio,) = [e.parameters["ratio"] for e in outcome.repaired.effects if (e.name, e.target) == ("gain_error", "slew")]
    assert ratio == pytest.approx(1.02, abs=2e-3)
