"""Speed over command of a valve axis, and the mass of a force axis, from motions whose truth is known."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from sysid.datasets.drafting.axis_values import characteristic, moved_mass

Array = npt.NDArray[np.float64]
RATE = 100.0


def pushes(rng: np.random.Generator, seconds: float) -> Array:
    """Commands of a stick that is pushed for a second or two and released, −1 to 1."""
    parts = []
    while sum(map(len, parts)) < seconds * RATE:
        level = float(rng.choice([-1.0, 1.0])) * float(rng.choice([1.0, rng.uniform(0.3, 1.0)]))
        parts += [np.full(rng.integers(80, 200), level), np.zeros(rng.integers(60, 150))]
    return np.concatenate(parts)[: round(seconds * RATE)]


def moved(share: Array, gain: float, dead: float, delay: float, lag: float) -> Array:
    flow = gain * np.sign(share) * np.maximum(np.abs(share) - dead, 0.0)
    late = np.concatenate([np.zeros(round(delay * RATE)), flow])[: len(flow)]
    keep = math.exp(-1.0 / (lag * RATE)) if lag > 0.0 else 0.0
    return np.cumsum(lfilter([1.0 - keep], [1.0, -keep], late)) / RATE


@settings(max_examples=examples(40), deadline=None)
@given(
    seed=st.integers(0, 2**31), gain=st.floats(0.02, 2.0), dead=st.floats(0.0, 0.25), delay=st.floats(0.0, 0.4),
    lag=st.floats(0.0, 0.3), zero=st.sampled_from([0.0, 1500.0, 2.5]), turns=st.sampled_from([1, -1]),
)  # fmt: skip
def test_neutral_and_speed_at_full_command(
    seed: int, gain: float, dead: float, delay: float, lag: float, zero: float, turns: int
) -> None:
    rng = np.random.default_rng(seed)
    span = 400.0 if zero == 1500.0 else 2.5 if zero else 1.0
    parts = []
    for _ in range(2):
        share = pushes(rng, 60.0)
        place = moved(share, gain, dead, delay, lag)
        parts.append((zero + turns * span * share, place + rng.normal(0.0, 1e-3 * gain, len(place))))
    found = characteristic(parts, RATE)
    assert found is not None
    assert found.rest[0] == pytest.approx(zero, abs=1e-9)
    assert found.at(zero + span, zero) == pytest.approx(turns * gain * (1.0 - dead), rel=0.02)
    assert found.at(zero - span, zero) == pytest.approx(-turns * gain * (1.0 - dead), rel=0.02)
    assert found.delay + found.lag == pytest.approx(delay + lag, abs=0.08)


def test_a_motion_without_rest_shows_where_it_reverses() -> None:
    time = np.arange(12000) / RATE
    share = 0.6 * np.sin(0.9 * time) + 0.4 * np.sin(2.3 * time)
    found = characteristic([(127.0 + 127.0 * share, moved(share, 0.1, 0.1, 0.1, 0.1))], RATE)
    assert found is not None
    assert math.isnan(found.rest[0])
    assert found.crossing == pytest.approx(127.0, abs=0.01 * 254.0)


def test_beyond_the_logs_the_speed_goes_on_along_the_larger_commands() -> None:
    rng = np.random.default_rng(0)
    share = 0.6 * pushes(rng, 120.0)
    found = characteristic([(share, moved(share, 0.2, 0.2, 0.1, 0.05))], RATE)
    assert found is not None
    assert found.at(1.0, 0.0) == pytest.approx(0.2 * 0.8, rel=0.05)


@pytest.mark.parametrize("rows", [0, 3, 150, 20000])
def test_nothing_moves(rows: int) -> None:
    still = np.zeros(rows)
    assert characteristic([(still, still)], RATE) is None
    assert characteristic([], RATE) is None
    assert math.isnan(moved_mass([(still, still)], RATE))


@settings(max_examples=examples(40), deadline=None)
@given(
    seed=st.integers(0, 2**31), mass=st.floats(0.01, 100.0), viscous=st.floats(0.0, 2.0), coulomb=st.floats(0.0, 1.0),
    load=st.floats(-2.0, 2.0), noise=st.floats(0.0, 5e-4),
)  # fmt: skip
def test_a_mass_beside_friction_and_load(
    seed: int, mass: float, viscous: float, coulomb: float, load: float, noise: float
) -> None:
    rng = np.random.default_rng(seed)
    time = np.arange(6000) / RATE
    waves = [(f, rng.uniform(0.05, 0.2), rng.uniform(0.0, 6.0)) for f in (1.1, 2.9, 5.3)]
    place = sum(a * np.sin(f * time + p) for f, a, p in waves)
    speed = sum(a * f * np.cos(f * time + p) for f, a, p in waves)
    acceleration = sum(-a * f**2 * np.sin(f * time + p) for f, a, p in waves)
    force = mass * (acceleration + viscous * speed + coulomb * np.sign(speed) + load)
    seen = np.asarray(place) + rng.normal(0.0, noise, len(time))
    assert moved_mass([(force, seen)], RATE) == pytest.approx(mass, rel=0.1)


def test_a_force_against_the_acceleration_is_no_mass() -> None:
    time = np.arange(4000) / RATE
    assert math.isnan(moved_mass([(np.sin(2.0 * time), np.sin(2.0 * time))], RATE))
