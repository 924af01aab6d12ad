"""Which of the effects that a fit moves get a name: small ones, those beside others, those that another could stand for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from plant_data import ROLES, arm_inputs, measured, nominal
from slew_search import gathered, named_at_slew, search_at_slew, slewing

from sysid.datasets.recording import Dataset
from sysid.gap.makeshift import makeshift
from sysid.gap.search import Search
from sysid.gap.strictness import Strictness
from sysid.machine import KnownEffect
from sysid.plant import nominal_plant

Array = npt.NDArray[np.float64]
NOISE = 3e-3


def lopsided(command: Array) -> Array:
    """Less than a hundredth faster one way."""
    return np.asarray(np.where(command < 0.0, 1.0085, 1.0) * command)


def narrowing(command: Array) -> Array:
    """An edge of a valve that is wider the further it opens: no power of the command."""
    return np.asarray(0.7 * command + 0.3 * command * np.abs(command))


def test_a_small_departure_that_all_depends_on_has_a_name_where_what_was_fitted_is_explained() -> None:
    wandering = slewing(lopsided, (0.03, 0.03, 0.08, 0.03), noise=NOISE)  # the recording to select by wanders more
    plant = nominal_plant(wandering.machine)
    assert named_at_slew(wandering, plant, Strictness()) == {"asymmetric_gain"}


@pytest.mark.parametrize("wander", [0.03, 0.07])
def test_a_machine_without_it_has_none(wander: float) -> None:
    dataset = slewing(lambda command: command, (wander,) * len(ROLES), noise=NOISE)
    assert named_at_slew(dataset, nominal_plant(dataset.machine), Strictness()) == set()


def test_what_depends_on_it_is_not_enough_where_fitted_recordings_stay_unexplained() -> None:
    dataset = slewing(lopsided, (0.07,) * len(ROLES), noise=NOISE)
    assert named_at_slew(dataset, nominal_plant(dataset.machine), Strictness()) == set()


def test_a_gain_that_makes_up_for_a_curve_has_no_name(monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = slewing(narrowing, part=0.4)
    assert named_at_slew(dataset, nominal(), Strictness()) == {"gain_curve"}
    monkeypatch.setattr("sysid.gap.search.makeshift", lambda fit, strange: [])
    assert named_at_slew(dataset, nominal(), Strictness()) == {"gain_curve", "gain_error"}


def plain(effects: Mapping[str, Mapping[str, float]], one_size: bool = False) -> Dataset:
    """Recordings of the plant with these effects at its slew; with ``one_size`` every stroke is of half the full command."""
    plant = nominal()
    for name, parameters in effects.items():
        plant = plant.with_effect(KnownEffect(name, "slew", dict(parameters)))
    runs = []
    for k in range(len(ROLES)):
        made = arm_inputs(f"run-{k + 1}", 60.0, k)
        slew = made.table["slew.command"].to_numpy()
        command = 0.5 * np.sign(slew) if one_size else slew
        still = replace(made, table=made.table.assign(**{"slew.command": command, "boom.command": 0.0, "wrist.command": 0.0}))
        runs.append(measured(plant, still, k))
    return gathered(nominal().machine, runs)


def test_what_scales_a_speed_beside_a_pump_that_gives_out_has_no_name() -> None:
    search = search_at_slew(plain({"gain_error": {"ratio": 0.9}}), nominal())
    pump, side, lag = (
        next(c for c in search.candidates if c.effect.name == name)
        for name in ("pump_flow_limit", "asymmetric_gain", "first_order_lag")
    )
    fit = search.scores.fit((pump, side, lag), ())
    assert makeshift(fit, strange=True) == [side]
    assert makeshift(fit, strange=False) == []
    assert makeshift(search.scores.fit((side, lag), ()), strange=True) == []


def elsewhere(search: Search, found: str, rival: str) -> bool:
    """Whether ``rival`` in the place of ``found`` explains something else."""
    one, other = (next(c for c in search.candidates if c.effect.name == name) for name in (found, rival))
    model = search.scores.fit((one,), ())
    return search.ties.explains_else(search.scores.fit((other,), (model,)), one, model)


def test_a_rival_that_explains_something_else_is_none() -> None:
    leak, ringing = {"internal_leakage": {"rate": 2e-3}}, {"oil_compressibility": {"frequency": 3.0, "damping_ratio": 0.1}}
    both = search_at_slew(plain(leak | ringing), nominal())
    assert elsewhere(both, "internal_leakage", "oil_compressibility")
    assert elsewhere(both, "oil_compressibility", "internal_leakage")


def test_a_rival_that_takes_its_place_is_one() -> None:
    """Of strokes of one size a gain and a curve are the same."""
    weak = search_at_slew(plain({"gain_error": {"ratio": 0.9}}, one_size=True), nominal())
    assert not elsewhere(weak, "gain_error", "gain_curve")
    assert not elsewhere(weak, "gain_curve", "gain_error")
