"""Input shapers: no vibration at the design frequency, a bounded one off it, and the same for a sampled signal."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from crane_model import crane_plant
from hypothesis import given
from hypothesis import strategies as st

from sysid.errors import InputError, SettingsError
from sysid.machine import KnownEffect
from sysid_rl.control.input_shaper import SHAPERS, InputShaper, ShapedSetpoints, ShaperKind, input_shaper
from sysid_rl.control.pendulum import Pendulum, pendulum_of

Array = npt.NDArray[np.float64]
kinds = st.sampled_from(SHAPERS)
frequencies = st.floats(0.5, 60.0)
dampings = st.floats(0.0, 0.7)


def swing(pivot: Array, frequency: float, damping_ratio: float, dt: float) -> Array:
    """Deflection and speed/ω, (n, 2), of d̈ + 2ζω·ḋ + ω²·d = −a for a pivot that moves evenly between samples: exact steps."""
    rate, decay = frequency * math.sqrt(1.0 - damping_ratio**2), damping_ratio * frequency
    c, s, fade = math.cos(rate * dt), math.sin(rate * dt), math.exp(-decay * dt)
    d, v = 0.0, 0.0
    out, before = np.empty((len(pivot), 2)), 0.0
    for k in range(len(pivot)):
        speed = (pivot[k] - pivot[k - 1]) / dt if k else 0.0
        v -= speed - before  # the pivot's speed changes at samples only
        before = speed
        d, v = (
            fade * (d * (c + decay / rate * s) + v * s / rate),
            fade * (v * (c - decay / rate * s) - d * frequency**2 / rate * s),
        )
        out[k] = d, v / frequency
    return out


@given(kinds, frequencies, dampings)
def test_no_vibration_at_the_design_frequency(kind: ShaperKind, frequency: float, damping_ratio: float) -> None:
    shaper = input_shaper(kind, frequency, damping_ratio)
    assert math.fsum(shaper.amplitudes) == pytest.approx(1.0)
    assert min(shaper.amplitudes) > 0.0
    assert shaper.residual(frequency, damping_ratio) < 1e-12


@given(frequencies, dampings, st.floats(-0.2, 0.2))
def test_off_the_design_frequency_the_vibration_is_bounded(frequency: float, damping_ratio: float, error: float) -> None:
    """ZV: |1 + e^(iπx)|/2 = |cos(πx/2)| for an undamped mode at x times the frequency; ZVD: its square. Damping lowers both."""
    zv, zvd = (input_shaper(kind, frequency, 0.0) for kind in SHAPERS)
    share = abs(math.cos(0.5 * math.pi * (1.0 + error)))
    assert zv.residual((1.0 + error) * frequency, 0.0) == pytest.approx(share, abs=1e-9)
    assert zvd.residual((1.0 + error) * frequency, 0.0) == pytest.approx(share**2, abs=1e-9)
    assert zv.residual((1.0 + error) * frequency, 0.0) <= 0.5 * math.pi * abs(error) + 1e-9
    damped = [input_shaper(kind, frequency, damping_ratio) for kind in SHAPERS]
    for shaper, order in zip(damped, (1, 2), strict=True):
        assert shaper.residual((1.0 + error) * frequency, damping_ratio) <= (0.5 * math.pi * abs(error)) ** order + 1e-9


def test_zvd_has_no_slope_at_the_design_frequency() -> None:
    for damping_ratio in (0.0, 0.04, 0.3):
        near = [input_shaper(kind, 6.7, damping_ratio).residual(6.7 * 1.01, damping_ratio) for kind in SHAPERS]
        assert near[0] == pytest.approx(0.5 * math.pi * 0.01, rel=0.5)
        assert near[1] < 0.03 * near[0]


@given(kinds, st.floats(1.0, 12.0), st.floats(0.0, 0.3))
def test_a_sampled_signal_leaves_at_most_what_the_division_of_impulses_adds(kind: ShaperKind, w: float, zeta: float) -> None:
    rate = 100.0
    shaper = input_shaper(kind, w, zeta)
    taps = shaper.taps(rate)
    assert taps.sum() == pytest.approx(1.0)
    begin = np.zeros(40)
    ramp = np.concatenate([begin, np.full(len(taps) + 2, 1.0 / rate)])  # a start at 1 m/s: amplitude 1/ω without a shaper
    pivot = np.cumsum(np.convolve(ramp, taps)[: len(ramp)])
    state = swing(pivot, w, zeta, 1.0 / rate)[-1]
    energy = math.sqrt(state[0] ** 2 + state[1] ** 2 + 2.0 * zeta * state[0] * state[1])
    assert energy * w <= (w / rate) ** 2 / 8.0 * 1.1 + 1e-9


def test_one_sample_at_a_time_is_the_convolution_and_is_restored() -> None:
    shaper = input_shaper("zvd", 6.7, 0.04)
    signal = np.random.default_rng(0).normal(size=(300, 2, 3))
    stream = ShapedSetpoints(shaper, 100.0, 3, copies=2)
    stream.reset(np.zeros(3))
    taps = shaper.taps(100.0)
    out = []
    for k, row in enumerate(signal):
        if k == 150:
            kept = stream.state()
            stream.reset(np.ones(3))
            stream.restore(kept)
        out.append(stream.step(row))
    expected = np.apply_along_axis(lambda column: np.convolve(column, taps)[:300], 0, signal)
    np.testing.assert_allclose(out, expected, atol=1e-12)


def test_rest_stays_rest_and_bounds_are_kept() -> None:
    stream = ShapedSetpoints(input_shaper("zv", 6.7, 0.04), 100.0, 2)
    stream.reset([0.3, -0.2])
    np.testing.assert_allclose(stream.step(np.array([[0.3, -0.2]])), [[0.3, -0.2]])
    out = np.array([stream.step(np.array([[1.0, -1.0]]))[0] for _ in range(200)])
    assert out[:, 0].max() <= 1.0 + 1e-12
    assert out[:, 1].min() >= -1.0 - 1e-12
    np.testing.assert_allclose(out[-1], [1.0, -1.0])


def test_mean_delay() -> None:
    assert InputShaper((0.0, 0.4), (0.5, 0.5)).delay == pytest.approx(0.2)
    assert input_shaper("zvd", 2.0 * math.pi, 0.0).delay == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("kind", "frequency", "damping_ratio", "message"),
    [("zvv", 6.0, 0.1, "zv"), ("zv", 0.0, 0.1, "above zero"), ("zv", math.nan, 0.1, "above zero"), ("zv", 6.0, 1.0, "below 1")],
)
def test_impossible_shapers_are_refused(kind: str, frequency: float, damping_ratio: float, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        input_shaper(kind, frequency, damping_ratio)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="never reset"):
        ShapedSetpoints(input_shaper("zv", 6.0, 0.1), 100.0, 2).step(np.zeros((1, 2)))


def test_the_pendulum_of_a_plant() -> None:
    plant = crane_plant(KnownEffect("gripper_sway", "tool", {"length": 0.22, "damping_ratio": 0.04}))
    pendulum = pendulum_of(plant)
    assert pendulum.frequency == pytest.approx(math.sqrt(9.80665 / 0.22), rel=1e-3)
    assert pendulum.period == pytest.approx(2.0 * math.pi / pendulum.frequency / math.sqrt(1.0 - 0.04**2))
    with pytest.raises(SettingsError, match="gripper_sway"):
        pendulum_of(crane_plant())


def test_the_tip_path_leads_the_tool_along_its_path() -> None:
    """A slow smooth motion of the tool; the undamped pendulum below the computed tip follows it."""
    t = np.arange(400) / 100.0
    s = np.clip(t / 3.0, 0.0, 1.0)
    way = s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)
    tool = np.column_stack([0.4 * way, 0.0 * t, 0.0 * t])
    pendulum = Pendulum(0.22, 0.0)
    tip = pendulum.tip_path(tool, 100.0)
    np.testing.assert_allclose(tip[:, 2], 0.22, atol=1e-3)
    bob = tip[:, 0] + swing(tip[:, 0], pendulum.frequency, 0.0, 0.01)[:, 0]
    assert np.abs(bob - tool[:, 0]).max() < 2e-3
    assert np.abs(tip[:, 0] - tool[:, 0]).max() > 4e-3, "else the test shows nothing"
