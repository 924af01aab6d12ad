"""The proof takes names away again, together with what they leaned on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plant_data import dataset_of, nominal, slide

from sysid.gap import find_gap
from sysid.gap.candidates import as_nuisance
from sysid.gap.case import open_case, stage_candidates
from sysid.gap.data import Data
from sysid.gap.evidence import Comparison
from sysid.gap.finding import Finding, Kept
from sysid.gap.fit import fit_candidates, place
from sysid.gap.prove import _departs_clearly, judge
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


def test_a_sensor_that_reads_too_much_is_no_gain_as_well() -> None:
    """The cylinder's own sensor reads 0.6 % too much: at its joint that is a scale, and at its valve it looks like a gain."""
    plant = nominal()
    true = plant.with_effect(KnownEffect("sensor_scale", "boom.cylinder", {"scale": 1.006}))
    found = find_gap(dataset_of(true, 20.0, seed=5), plant)
    assert [(effect.name, effect.target) for effect in found.effects] == [("sensor_scale", "boom.cylinder")]
    assert found.effects[0].parameters["scale"] == pytest.approx(1.006, abs=1e-4)
    after, floor = found.stage_gap.after["boom.cylinder"], found.stage_gap.noise_floor["boom.cylinder"]
    assert after < 1.1 * floor


@pytest.mark.parametrize(("ratio", "clearly"), [(1.02, True), (1.0004, False)])
def test_another_value_of_what_is_known_has_to_be_clear_of_it(ratio: float, clearly: bool) -> None:
    plant = nominal().with_effect(KnownEffect("gain_error", "slew", {"ratio": 1.0}))
    case, stages = open_case(dataset_of(plant, 14.0, seed=5), plant, 0)
    stage = next(s for s in stages if s.label == "command stage of slew")
    gain = next(c for c in stage_candidates(case, stage) if c.effect.name == "gain_error")
    assert gain.known
    seen = Data(stage.problem, stage.split.seen, stage.sigma)
    fit = fit_candidates(seen, case.theta, (gain,), [np.array([1.0])])
    fit = replace(fit, values=np.array([ratio]))
    assert _departs_clearly(gain, fit, np.array([[ratio - 0.0005, ratio + 0.0005]])) == clearly


def test_a_small_value_that_everything_depends_on_gets_its_name() -> None:
    """A dead time that is 0.7 ms longer: hardly more than clocks are known by, and most of what a precise servo is off."""
    lag = KnownEffect("first_order_lag", "wrist", {"time_constant": 0.04})
    plant = nominal(lag, KnownEffect("input_delay", "wrist", {"delay": 0.03}))
    true = nominal(lag, KnownEffect("input_delay", "wrist", {"delay": 0.0307}))
    found = find_gap(dataset_of(true, 20.0, seed=5), plant)
    assert [(effect.name, effect.target) for effect in found.effects] == [("input_delay", "wrist")]
    assert found.effects[0].parameters["delay"] == pytest.approx(0.0307, abs=1e-4)


def test_of_two_names_for_one_thing_the_simpler_one_is_taken() -> None:
    """While a slide moves, a load is a friction that differs by direction; the latter takes one number more to say so."""
    known = KnownEffect("coulomb_friction", "slide", {"force": 8.0})
    true = nominal(known, KnownEffect("load_bias", "slide", {"force": 3.0}), machine=slide())
    found = find_gap(dataset_of(true, 8.0, seed=5), nominal(known, machine=slide()))
    assert [effect.name for effect in found.effects] == ["load_bias"]
    assert found.effects[0].parameters["force"] == pytest.approx(3.0, abs=0.02)
    assert found.ambiguous == ()
