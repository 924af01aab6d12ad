"""The Kalman filter that whitens: against dense covariances, and on series of its own model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

from sysid.gap.likelihood.disturbance import DIFFUSE, Disturbance, Filter, filter_of

Array = npt.NDArray[np.float64]
FLOW = Disturbance(noise=0.05, still=0.02, moving=0.3, memory=0.6)
#: The same and an error of the output itself.
RIPPLE = Disturbance(noise=0.05, still=0.02, moving=0.1, memory=0.6, ripple=0.2, ripple_memory=0.15)


@dataclass(frozen=True)
class Inputs:
    """What a filter is made of beside the variances."""

    step: Array
    activity: Array
    present: npt.NDArray[np.bool_]
    restart: npt.NDArray[np.bool_]
    extra: Array

    def filter(self, disturbance: Disturbance, integrates: bool) -> Filter:
        return filter_of(disturbance, self.step, self.activity, self.present, self.restart, self.extra, 1.0, integrates)


def inputs(count: int, seed: int = 0, runs: int = 2, missing: float = 0.15) -> Inputs:
    rng = np.random.default_rng(seed)
    restart = np.zeros(count, dtype=bool)
    restart[:: count // runs] = True
    present = rng.random(count) > missing
    return Inputs(rng.uniform(0.03, 0.12, count), rng.uniform(0.0, 2.0, count), present, restart, rng.uniform(0.0, 1e-3, count))


def drawn(given: Inputs, disturbance: Disturbance, integrates: bool, shocks: Array) -> Array:
    """Series (n, m) of the model from standard normal ``shocks`` (4, n, m), equation by equation of its docstring."""
    level, state, own = (np.zeros(shocks.shape[2]) for _ in range(3))
    out = np.zeros(shocks.shape[1:])
    for k in range(len(given.step)):
        size, phi = disturbance.ripple * given.activity[k], np.exp(-given.step[k] / disturbance.ripple_memory)
        own = size * shocks[3, k] if given.restart[k] else phi * own + np.sqrt(1.0 - phi**2) * size * shocks[3, k]
        amplitude = np.hypot(disturbance.still, disturbance.moving * given.activity[k])
        rho = np.exp(-given.step[k] / disturbance.memory)
        if given.restart[k]:
            level = DIFFUSE * shocks[2, k]
            state = shocks[0, k]
        else:
            level = level + given.step[k] * amplitude * state + np.sqrt(given.extra[k]) * shocks[2, k]
            state = rho * state + np.sqrt(1.0 - rho**2) * shocks[0, k]
        out[k] = (level + own if integrates else amplitude * state) + disturbance.noise * shocks[1, k]
    return out


def dense(given: Inputs, disturbance: Disturbance, integrates: bool) -> Array:
    """Covariance of the present rows, (m, m), from the response to every single shock."""
    n = len(given.step)
    response = drawn(given, disturbance, integrates, np.eye(4 * n).reshape(4, n, 4 * n))
    return (response @ response.T)[np.ix_(given.present, given.present)]


def whitened(used: Filter, columns: Array) -> Array:
    out = np.empty(columns.shape)
    used.whiten(columns, out)
    return out


@pytest.mark.parametrize(("disturbance", "integrates"), [(FLOW, True), (FLOW, False), (RIPPLE, True)])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_innovations_give_the_density_of_the_dense_covariance(
    disturbance: Disturbance, integrates: bool, seed: int
) -> None:
    """Runs that restart, rows that are missing and steps of any length included."""
    given = inputs(60, seed)
    used = given.filter(disturbance, integrates)
    series = np.random.default_rng([seed, 1]).standard_normal((60, 1))
    covariance = dense(given, disturbance, integrates)
    y = series[given.present, 0]
    white = whitened(used, series)
    assert float(white[:, 0] @ white[:, 0]) == pytest.approx(float(y @ np.linalg.solve(covariance, y)), rel=1e-6)
    assert used.log_scale == pytest.approx(0.5 * np.linalg.slogdet(covariance)[1], rel=1e-9)


@pytest.mark.parametrize(("disturbance", "integrates"), [(FLOW, True), (FLOW, False), (RIPPLE, True)])
def test_a_disturbance_of_the_model_becomes_white_with_unit_variance(disturbance: Disturbance, integrates: bool) -> None:
    given = inputs(6000, 2)
    series = drawn(given, disturbance, integrates, np.random.default_rng(5).standard_normal((4, 6000, 1)))
    white = whitened(given.filter(disturbance, integrates), series)[given.present & ~given.restart, 0]
    bound = 3.5 / np.sqrt(len(white))
    assert np.std(white) == pytest.approx(1.0, abs=3.5 / np.sqrt(2 * len(white)))
    assert np.mean(white) == pytest.approx(0.0, abs=bound)
    for lag in (1, 2, 5, 20):
        assert abs(float(white[lag:] @ white[:-lag]) / float(white @ white)) < bound, lag
    plain = series[:3000, 0]  # one run
    assert np.corrcoef(plain[1:], plain[:-1])[0, 1] > 0.5, "the series itself is coloured"


@pytest.mark.parametrize("integrates", [True, False])
def test_whitening_is_linear(integrates: bool) -> None:
    given = inputs(200, 3)
    used = given.filter(FLOW, integrates)
    one, other = np.random.default_rng(4).standard_normal((2, 200, 3))
    assert np.allclose(whitened(used, 2.0 * one - 3.0 * other), 2.0 * whitened(used, one) - 3.0 * whitened(used, other))


def test_missing_rows_say_nothing() -> None:
    given = inputs(100, 6)
    used = given.filter(FLOW, True)
    series = np.random.default_rng(7).standard_normal((100, 1))
    white = whitened(used, series)
    assert (white[~given.present] == 0.0).all()
    changed = series.copy()
    changed[~given.present] += 1e3
    assert np.array_equal(whitened(used, changed), white)


def test_a_constant_offset_is_no_evidence_where_the_stage_integrates() -> None:
    given = inputs(200, 8, runs=4)
    series = np.random.default_rng(9).standard_normal((200, 1))
    for integrates, most in ((True, 1e-3), (False, np.inf)):
        used = given.filter(FLOW, integrates)
        moved = whitened(used, np.full((200, 1), 0.3))
        assert float((moved**2).sum()) < most
    assert float((moved**2).sum()) > 1.0, "it is evidence where nothing integrates"
    assert float((whitened(given.filter(FLOW, True), series) ** 2).sum()) > 1.0


def test_without_a_disturbance_rows_are_scaled_by_the_noise() -> None:
    given = inputs(50, 10, missing=0.0)
    series = np.random.default_rng(11).standard_normal((50, 2))
    used = given.filter(Disturbance(0.05, 0.0, 0.0, 0.5), False)
    assert np.allclose(whitened(used, series), series / 0.05)
    assert used.log_scale == pytest.approx(50 * np.log(0.05))
