"""One statement: the verdict, its sentence, and every figure of a result say the same."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant_data import ROLES, arm_inputs, dataset_of, loaded_arm, measured, nominal, slide
from scipy.signal import lfilter

from sysid.datasets.recording import Dataset
from sysid.display import signal_name
from sysid.gap import GapResult, find_gap
from sysid.gap.statement import AGREES, Agreement, FloorSource, headline, response_differences, response_sentences, verdict_of
from sysid.machine import KnownEffect
from sysid.plant import Plant

SOURCES: tuple[FloorSource, ...] = ("stated", "rest", "two_sensors", "above_bandwidth", "unknown")
sizes = st.floats(0.0, 1e3) | st.just(math.inf)
signals = st.builds(
    Agreement, st.sampled_from(["a.joint", "ee.x"]), st.just("run"), sizes, sizes, st.floats(0.0, 10.0),
    st.sampled_from(SOURCES), st.floats(0.0, 100.0), st.booleans(), st.sampled_from(["rad", "m"]),
)  # fmt: skip


@given(st.lists(signals, max_size=4), st.booleans(), st.booleans(), st.booleans(), st.booleans())
def test_no_gap_is_said_of_signals_that_agree_and_that_could_disagree(
    agreement: list[Agreement], named: bool, tied: bool, unnamed: bool, lacking: bool
) -> None:
    verdict = verdict_of(named, tied, unnamed, lacking, agreement)
    if verdict == "no_gap":
        assert agreement
        for item in agreement:
            assert max(item.before, item.after) <= AGREES * item.noise_floor
            assert item.floor_source != "unknown"
            assert item.moved
            assert item.noise_floor <= 0.1 * item.motion
    differs = any(item.moved and not max(item.before, item.after) <= AGREES * item.noise_floor for item in agreement)
    if differs and not (named or tied or lacking):
        assert verdict == "unnamed"


@given(st.lists(signals, min_size=1, max_size=4), st.booleans())
def test_the_sentence_states_the_largest_error_and_what_runs_away_comes_first(agreement: list[Agreement], named: bool) -> None:
    verdict = verdict_of(named, False, False, False, agreement)
    text = headline(verdict, int(named), agreement)
    errors = {item.signal: item.after if named else item.worst for item in agreement}
    beyond = [item for item in agreement if not item.floors(item.after if named else item.worst) <= AGREES]
    if any(item.is_away(item.after if named else item.worst) for item in beyond):
        assert text.startswith("The simulation does not follow the machine: ")
    assert any(f"{signal_name(signal)} is off by" in text for signal in errors) == bool(beyond)
    away = any(item.is_away(item.after if named else item.worst) for item in beyond)
    assert ("With the repair, " in text) == (named and bool(beyond) and not away)


@pytest.mark.slow
def test_a_disturbance_that_no_effect_explains_is_unnamed() -> None:
    """Two percent of the speed, at random: no effect is missing, and the free run is far off all the same."""
    found = wandering(0.02)
    assert (found.verdict, found.effects) == ("unnamed", ())
    assert any(item.depends_on == "nothing that was measured" for item in found.unnamed)
    assert "noise floor" in found.headline
    consistent(found)


def test_without_anything_hidden_there_is_no_gap() -> None:
    found = undisturbed()
    assert (found.verdict, found.unnamed) == ("no_gap", ())
    assert {item.floor_source for item in found.agreement} == {"stated"}
    consistent(found)


def test_agreement_within_an_unknown_noise_says_nothing() -> None:
    """Readings at 5 Hz of a motion that is too fast for them: an upper bound of the noise explains every error."""
    item = undisturbed().agreement[0]
    unknown = replace(item, floor_source="unknown")
    assert verdict_of(False, False, False, False, [item, unknown]) == "unnamed"
    assert headline("unnamed", 0, [item, unknown], disagrees=False).endswith(
        "is not known: state it under [noise] in machine.toml."
    )
    still = replace(item, moved=False)
    assert verdict_of(False, False, False, False, [item, still]) == "insufficient_excitation"
    assert headline("insufficient_excitation", 0, [item, still], disagrees=False).endswith("does not move.")


def test_a_simulation_of_the_wrong_sign_is_said_first() -> None:
    true = nominal()
    data = dataset_of(true, 20.0)
    turned = [replace(r, table=r.table.assign(**{"slew.joint": -r.values("slew.joint")})) for r in data.recordings]
    found = find_gap(replace(data, recordings=tuple(turned)), true, localise_only=True)
    assert found.verdict == "unnamed"
    assert found.headline.startswith("The simulation does not follow the machine: slew joint is off by ")


@pytest.mark.slow
@pytest.mark.parametrize("effect", [KnownEffect("input_delay", "slew", {"delay": 0.1})])
def test_what_remains_after_a_repair_is_said_beside_the_names(effect: KnownEffect) -> None:
    found = wandering(0.02, effect, seconds=25.0)
    assert found.verdict == "named"
    assert "With the repair, " in found.headline
    consistent(found)


def test_what_the_recordings_show_without_a_model_is_compared_with_the_simulation() -> None:
    effects = [
        KnownEffect("input_delay", "slew", {"delay": 0.12}),
        KnownEffect("valve_deadband", "boom", {"positive": 0.35, "negative": 0.25}),
    ]
    inputs = [arm_inputs(f"run-{k}", 40.0, 60 + k) for k in range(2)]
    recordings = [measured(nominal(*effects), own, k) for k, own in enumerate(inputs)]
    machine, units = nominal().machine, {"slew.joint": "rad", "boom.cylinder": "m"}
    runs = [measured(nominal(), own, k).table for k, own in enumerate(inputs)]
    found = response_differences(recordings, runs, machine, units)
    (delay,) = (item for item in found if item.quantity == "delay" and item.axis == "slew")
    assert delay.recorded[0] - delay.simulated[1] > 0.08
    begins = {item.side: item for item in found if item.quantity == "begins" and item.axis == "boom"}
    assert begins["positive"].recorded[0] <= 0.35 <= begins["positive"].recorded[1]
    sentences = response_sentences(found, repaired=True)
    assert sentences[0].startswith("Without a model slew differs from the repaired simulation: it follows its command after ")
    assert any("positive commands move it from 0.3" in sentence for sentence in sentences)
    assert response_differences(recordings, [recording.table for recording in recordings], machine, units) == ()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(24))
def test_sealed_machines_with_and_without_what_no_effect_explains(seed: int) -> None:
    """Valves, servos and forces; a random, slow, wave-like or creeping error of a thousandth to a tenth of the motion."""
    plant, data = generated(seed)
    found = find_gap(data, plant)
    assert (found.verdict, found.effects, found.responses) == ("no_gap", (), ())
    consistent(found)
    found = find_gap(disturbed(data, seed), plant)
    assert found.verdict != "no_gap" or not any(item.differs for item in found.agreement)
    consistent(found)


def generated(seed: int) -> tuple[Plant, Dataset]:
    plant = (nominal(), nominal(machine=slide()), nominal(machine=loaded_arm()))[seed % 3]
    return plant, dataset_of(plant, float(np.random.default_rng([seed, 7]).uniform(12.0, 25.0)), seed)


def disturbed(data: Dataset, seed: int) -> Dataset:
    """The dataset with an error on every measured motion."""
    rng, recordings = np.random.default_rng([seed, 8]), []
    form, size = rng.choice(["wander", "drift", "wave", "creep"]), float(10.0 ** rng.uniform(-3.0, -1.0))
    for k, recording in enumerate(data.recordings):
        own, time, columns = np.random.default_rng([seed, k]), recording.values("time"), {}
        for signal in (s for s in recording.signals if s.endswith((".joint", ".cylinder")) and s != "boom.joint"):
            place = recording.values(signal)
            spread = float(np.std(place))
            noise = lfilter([0.2], [1.0, -0.98], own.standard_normal(len(place)))
            columns[signal] = (
                place
                + size
                * {
                    "wander": np.cumsum(noise * np.abs(np.gradient(place))),
                    "drift": spread * np.sin(2.0 * np.pi * time / own.uniform(7.0, 10.0) + own.uniform(0.0, 6.0)),
                    "wave": spread * np.sin(17.0 * place / spread + 1.0) * np.exp(-time / 20.0),
                    "creep": lfilter([1.0 / 300.0], [1.0, 1.0 / 300.0 - 1.0], place - place[0]),
                }[form]
            )
        recordings.append(replace(recording, table=recording.table.assign(**columns)))
    return replace(data, recordings=tuple(recordings))


def wandering(share: float, *effects: KnownEffect, seconds: float = 15.0) -> GapResult:
    """The gap of a slew and a boom whose speeds wander at random by a share of them, with a machine that lacks ``effects``."""
    plant, recordings = nominal(*effects), []
    for k in range(len(ROLES)):
        recording = measured(plant, arm_inputs(f"run-{k + 1}", seconds, 30 + k), 30 + k)
        rng, columns = np.random.default_rng([3, k]), {}
        for signal, size in (("slew.joint", 0.2), ("boom.cylinder", 0.012)):
            there = recording.values(signal)
            moving = np.abs(np.gradient(there)) > 1e-2 * size / 100.0
            flow = lfilter([0.2], [1.0, -0.98], rng.standard_normal(len(there)))
            columns[signal] = there + np.cumsum(0.9 * share * size * flow * moving) / 100.0
        kept = recording.table[["time", "slew.command", "boom.command"]]
        recordings.append(replace(recording, table=kept.assign(**columns)))
    splits = {r.name: role for r, role in zip(recordings, ROLES, strict=True)}
    return find_gap(Dataset.of(plant.machine, recordings, splits), nominal())


@functools.cache
def undisturbed() -> GapResult:
    return wandering(0.0)


def consistent(found: GapResult) -> None:
    """No figure contradicts another: the pooled error of a signal is not above that of its worst recording."""
    values = found.to_json()
    assert (values["verdict"], values["headline"]) == (found.verdict, found.headline)
    for item in found.agreement:
        assert item.after >= found.gap.after[item.signal] * (1.0 - 1e-9)
    if found.verdict == "no_gap":
        for signal, error in found.gap.after.items():
            assert error <= AGREES * found.gap.noise_floor[signal]
