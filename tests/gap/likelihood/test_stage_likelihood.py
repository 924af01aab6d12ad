"""The marginal likelihood of a model: against dense Gaussians, refits without a block, and the model that made the data."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from regression_stage import NOISE, candidate, discrepancy, functions, likelihood, rows_of
from scipy.stats import multivariate_normal

from sysid.gap.likelihood.block_products import block_products, predictive_densities
from sysid.gap.likelihood.stage import DAMPING, ModelFit, Prior, StageLikelihood, _stepped, fit_model, prior_of, share_of

Array = npt.NDArray[np.float64]


def fitted(table: StageLikelihood, *places: int) -> ModelFit:
    chosen = [candidate(k) for k in places]
    return fit_model(table, chosen, np.zeros((1, len(places))))


def test_block_densities_are_those_of_a_refit_without_the_block() -> None:
    rng = np.random.default_rng(0)
    X, r = rng.standard_normal((40, 5)) * [3.0, 1.0, 0.3, 5.0, 0.01], rng.standard_normal(40)
    block = rng.integers(0, 6, 40)
    X[7], r[7] = 0.0, 0.0  # a row that is not measured
    products = block_products(X, r, block, 6)
    found = predictive_densities(products, X.T @ r, products.information)
    begin = rng.standard_normal(5)  # the same from the residual at other coefficients
    moved = block_products(X, r - X @ begin, block, 6)
    pull = X.T @ (r - X @ begin) - begin
    assert predictive_densities(moved, pull, moved.information) == pytest.approx(found)
    for b in range(6):
        inside = block == b
        rest = X[~inside]
        covariance = np.linalg.inv(rest.T @ rest + np.eye(5))
        mean = covariance @ rest.T @ r[~inside]
        Xb = X[inside]
        density = multivariate_normal(Xb @ mean, np.eye(inside.sum()) + Xb @ covariance @ Xb.T)
        assert found[b] == pytest.approx(density.logpdf(r[inside]) + 0.5 * inside.sum() * np.log(2 * np.pi)), b


def test_products_side_by_side_are_those_of_the_whole_table() -> None:
    rows = rows_of((0.6, 0.2, 0.0), count=2, seconds=8.0)
    table, rng = likelihood(rows, tau=0.2), np.random.default_rng(0)
    slopes, residual = rng.standard_normal((rows.count, 2)), rng.standard_normal(rows.count)
    found = table.products_beside(slopes, residual)
    whole = np.hstack([table.linear.columns, slopes])
    for b in range(rows.blocks):
        X, r = whole[rows.block == b], residual[rows.block == b]
        assert found.gram[b] == pytest.approx(X.T @ X)
        assert found.right[b] == pytest.approx(X.T @ r)
        assert found.squares[b] == pytest.approx(r @ r)


@pytest.mark.parametrize("places", [(), (0,), (0, 1)])
@pytest.mark.parametrize("disturbance", [1e-9, 0.3])
def test_the_evidence_is_the_density_of_the_data(places: tuple[int, ...], disturbance: float) -> None:
    """The stage is linear in θ, so that Laplace's approximation is exact: a normal with all of its covariances added up.

    The discrepancy is without what the effects can do; their widths are those of their sizes.
    """
    rows = rows_of((0.6, 0.2, 0.0), count=2, seconds=8.0)
    table = likelihood(rows, tau=0.2, disturbance=disturbance)
    y = rows.residuals(np.zeros((1, 3)))[0]
    covariance = NOISE**2 * np.eye(rows.count)
    for s in rows.series:
        gap = np.abs(s.time[:, None] - s.time[None, :])
        covariance[s.rows, s.rows] += disturbance**2 * np.exp(-gap / 0.5)
    found = fitted(table, *places)
    prior = prior_of([candidate(k) for k in places])
    time = np.concatenate([s.time + 31.0 * s.recording for s in rows.series])
    slopes = functions(time)[:, list(places)]
    smooth = 0.2 * discrepancy(rows).columns
    wide = slopes * prior.width
    smooth = smooth - wide @ share_of(rows.scaled(wide), rows.scaled(wide).T @ rows.scaled(smooth))
    covariance += smooth @ smooth.T
    widths, cost = prior.at_scale(found.values)
    covariance += (slopes * widths) @ (slopes * widths).T
    density = multivariate_normal(np.zeros(rows.count), covariance).logpdf(y)
    assert found.evidence == pytest.approx(density + 0.5 * rows.count * np.log(2 * np.pi) - cost, abs=0.05)


def test_values_and_their_deviations_are_those_of_least_squares() -> None:
    rows = rows_of((0.6, -0.4, 0.0))
    found = fitted(likelihood(rows, tau=1e-9), 0, 1)
    time = np.concatenate([s.time + 31.0 * s.recording for s in rows.series])
    X = functions(time)[:, :2] / NOISE
    y = rows.residuals(np.zeros((1, 3)))[0] / NOISE
    H = X.T @ X + np.eye(2)  # starting values are ±1, so the prior's width is one
    assert found.values == pytest.approx(np.linalg.solve(H, X.T @ y), abs=1e-5)
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(np.sqrt(np.diag(np.linalg.inv(H))), rel=1e-5)
    assert found.left == pytest.approx(1.0, abs=0.05)
    assert found.response == pytest.approx(np.sqrt((functions(time)[:, :2] ** 2).mean(axis=0)) / NOISE, rel=1e-6)


def test_the_evidence_prefers_the_model_that_made_the_data() -> None:
    table = likelihood(rows_of((0.6, -0.4, 0.0)))
    true = fitted(table, 0, 1)
    for places in ((), (0,), (1,), (0, 1, 2)):
        assert fitted(table, *places).evidence < true.evidence, places
    assert fitted(table, 0).evidence < true.evidence - 50.0


def test_nothing_is_likelier_than_an_effect_where_there_is_none() -> None:
    for seed in range(5):
        table = likelihood(rows_of((0.0, 0.0, 0.0), seed=seed))
        assert max(fitted(table, k).evidence for k in range(3)) < fitted(table).evidence


def test_a_discrepancy_that_holds_an_effect_leaves_it_to_the_effect() -> None:
    """Orthogonal to the output of an effect, it neither undoes it nor widens its interval."""
    rows = rows_of((0.6, 0.0, 0.0))
    time = np.concatenate([s.time + 31.0 * s.recording for s in rows.series])
    same = functions(time)[:, :1]
    alone, shared = (fitted(likelihood(rows, tau, columns=same), 0) for tau in (1e-9, 10.0))
    assert shared.values == pytest.approx(alone.values, abs=1e-3)
    assert shared.deviations_of(candidate(0))[0] == pytest.approx(alone.deviations_of(candidate(0))[0], rel=0.01)


def test_a_discrepancy_that_holds_no_effect_of_the_model_stays_as_it_is() -> None:
    rows = rows_of((0.6, 0.4, 0.0))
    time = np.concatenate([s.time + 31.0 * s.recording for s in rows.series])
    other = functions(time)[:, 1:2]
    without, with_it = (fitted(likelihood(rows, tau, columns=other), 0) for tau in (1e-9, 10.0))
    assert with_it.evidence > without.evidence + 50.0, "it explains what no effect of the model does"


def test_the_size_of_an_effect_is_unknown_over_decades() -> None:
    """A small effect costs as much evidence as a large one; what does not move from its centre costs nothing of the data."""
    known = prior_of([candidate(0)])
    assert known.width[0] > known.finest[0]
    small, large = known.at_scale(np.array([0.01])), known.at_scale(np.array([0.1]))
    assert small[1] == large[1] > 0.0
    assert small[0] == pytest.approx([0.01])
    assert known.at_scale(np.zeros(1))[0] == pytest.approx(known.finest)
    assert known.at_scale(np.array([1e6]))[0] == pytest.approx(known.width)


def test_columns_that_are_negligible_do_not_change_the_evidence() -> None:
    rows = rows_of((0.6, 0.0, 0.0))
    without, with_them = (fitted(likelihood(rows, tau), 0).evidence for tau in (0.0, 1e-5))
    assert with_them == pytest.approx(without, abs=0.02)


def test_a_fit_stays_inside_the_bounds() -> None:
    rows = rows_of((9.0, 0.0, 0.0))  # the bounds are ±5
    found = fitted(likelihood(rows), 0)
    assert found.values[0] == 5.0


@given(seed=st.integers(0, 2**32 - 1), damping=st.sampled_from(DAMPING))
def test_a_bounded_step_leads_to_the_least_value_of_the_quadratic(seed: int, damping: float) -> None:
    """Also where several unknowns would leave their bounds at once; clipped, such a step ended above its begin."""
    rng = np.random.default_rng(seed)
    for k in rng.integers(1, 7, 20):
        alike = rng.standard_normal((k + 2, 1)) + 10.0 ** rng.uniform(-3, 1) * rng.standard_normal((k + 2, k))
        slopes, width = alike * 10.0 ** rng.uniform(-1, 3, k), 10.0 ** rng.uniform(-3, 3, k)
        hessian, gradient = slopes.T @ slopes + np.eye(k), slopes.T @ rng.standard_normal(k + 2)
        low, high = np.zeros(k), width * rng.uniform(0.1, 3.0, k)
        begin = np.clip(width * rng.uniform(-0.5, 3.5, k), low, high)
        found = _stepped(begin, hessian, gradient, damping, Prior(begin, width, low, high, width))
        damped = hessian + damping * np.diag(np.diag(hessian))
        others = [
            begin,
            *(low + rng.uniform(0.0, 1.0, (50, k)) * (high - low)),
            *(0.999 * found + 1e-3 * x for x in (low, high)),
        ]
        steps = (np.array([found, *others]) - begin) / width
        values = steps @ gradient + 0.5 * np.einsum("nj,jk,nk->n", steps, damped, steps)
        assert ((found >= low) & (found <= high)).all()
        assert values[0] <= values.min() + 1e-9 * (1.0 + np.abs(gradient) @ np.abs(steps[0]))
