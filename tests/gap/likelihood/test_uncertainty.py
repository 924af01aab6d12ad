"""How sure parameters are: the posterior where the model holds, wider where the blocks disagree."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.gap.likelihood.block_products import block_products, factored, posterior_covariance

Array = npt.NDArray[np.float64]
BLOCKS, ROWS = 30, 80
BLOCK = np.repeat(np.arange(BLOCKS), ROWS)


def drawn(seed: int, disagree: float) -> tuple[Array, Array]:
    """Columns (two of a discrepancy, two parameters) and a response whose last coefficient differs from block to block."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((BLOCKS * ROWS, 4))
    last = 0.5 + disagree * rng.standard_normal(BLOCKS)[BLOCK]
    return columns, 0.3 * columns[:, 2] + last * columns[:, 3] + rng.standard_normal(len(BLOCK))


def covariance_of(columns: Array, response: Array, block: npt.NDArray[np.int64]) -> Array:
    """Of the last two coefficients, from residuals at coefficients of zero."""
    return posterior_covariance(
        block_products(columns, response, block, BLOCKS).over(np.arange(BLOCKS)), 2, columns.T @ response
    )


def test_where_the_model_holds_it_is_the_posterior() -> None:
    columns, response = drawn(0, 0.0)
    found = covariance_of(columns, response, BLOCK)
    exact = np.linalg.inv(columns.T @ columns + np.eye(4))[2:, 2:]
    assert np.sqrt(np.diag(found)) == pytest.approx(np.sqrt(np.diag(exact)), rel=0.35)
    assert (np.diag(found) >= (1.0 - 1e-12) * np.diag(exact)).all(), "the blocks only widen it"


@pytest.mark.parametrize("disagree", [0.1, 0.3])
def test_where_blocks_disagree_it_is_the_scatter_of_repetitions(disagree: float) -> None:
    values, deviations = [], []
    for seed in range(60):
        columns, response = drawn(seed, disagree)
        values.append(np.linalg.solve(columns.T @ columns + np.eye(4), columns.T @ response)[3])
        deviations.append(np.sqrt(covariance_of(columns, response, BLOCK)[1, 1]))
    assert np.mean(deviations) == pytest.approx(np.std(values), rel=0.25)


def test_one_block_alone_says_nothing_of_scatter() -> None:
    columns, response = drawn(0, 0.5)
    exact = np.linalg.inv(columns.T @ columns + np.eye(4))[2:, 2:]
    products = block_products(columns, response, BLOCK, BLOCKS).over(np.zeros(BLOCKS, dtype=np.int64))
    assert np.allclose(posterior_covariance(products, 2, columns.T @ response), exact)


def test_rows_that_are_not_measured_change_nothing() -> None:
    columns, response = drawn(1, 0.2)
    more = np.vstack([columns, np.zeros((7, 4))])
    block = np.concatenate([BLOCK, np.full(7, BLOCKS - 1)])
    found = covariance_of(more, np.append(response, np.zeros(7)), block)
    assert np.allclose(found, covariance_of(columns, response, BLOCK))


@given(st.floats(1.0, 1e10), st.floats(0.0, 1e-3), st.integers(0, 100))
def test_products_of_nearly_parallel_columns_have_a_factor(size: float, apart: float, seed: int) -> None:
    """Two effects with like responses of a thousand million noise floors ended the search of a short log at 10 Hz."""
    draw = np.random.default_rng(seed)
    first, other = draw.standard_normal((2, 50))
    columns = size * np.column_stack([first, first + apart * other, 2.0 * first])
    information = columns.T @ columns + np.eye(3)
    factor = factored(information)
    np.testing.assert_allclose(factor @ factor.T, information, rtol=1e-9, atol=1e-9 * np.abs(information).max())
    if size < 1e3:
        np.testing.assert_array_equal(factor, np.linalg.cholesky(information))
