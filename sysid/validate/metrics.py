"""Error metrics of a prediction, coverage of its intervals and of the extrapolation flag on held-out rows, and the stationary
bootstrap of the mean of a series that is correlated in time.

Source: stationary bootstrap: Politis & Romano, JASA 89 (1994); length of the blocks: Politis & White, Econometric Reviews 23
(2004), corrected 28 (2009).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.current_folder import without_matplotlib
from sysid.errors import InputError

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class ErrorMetrics:
    """Metrics of ``error = predicted − truth`` over ``count`` rows, in ``unit``.

    ``max`` and the percentiles are of the error's magnitude; ``bias`` is the mean error.
    """

    count: int
    rmse: float
    max: float
    p50: float
    p95: float
    p99: float
    bias: float
    unit: str


def error_metrics(truth: Array, predicted: Array, unit: str) -> ErrorMetrics:
    """Compare two arrays (n,), both in ``unit``.

    Raises:
        InputError: no rows, different lengths, or numbers that are not finite.
    """
    from sklearn.metrics import max_error, root_mean_squared_error

    if truth.shape != predicted.shape or truth.ndim != 1 or not len(truth):
        raise InputError("error metrics", f"shapes {truth.shape} and {predicted.shape}", "two equal ones (n,), n > 0")
    if not (np.isfinite(truth).all() and np.isfinite(predicted).all()):
        raise InputError("error metrics", "values that are NaN or infinite", "finite numbers")
    p50, p95, p99 = np.percentile(np.abs(predicted - truth), [50, 95, 99])
    return ErrorMetrics(
        count=len(truth),
        rmse=float(root_mean_squared_error(truth, predicted)),
        max=float(max_error(truth, predicted)),
        p50=float(p50),
        p95=float(p95),
        p99=float(p99),
        bias=float(np.mean(predicted - truth)),
        unit=unit,
    )


#: Level at which intervals are evaluated, if there are enough calibration rows.
LEVEL = 0.95
THIRDS = ("lower", "middle", "upper")


@dataclass(frozen=True)
class Region:
    """Rows of one region: their number, the share of them inside their intervals, and their RMSE."""

    name: str
    count: int
    covered: float
    rmse: float


@dataclass(frozen=True)
class Coverage:
    """Coverage and flagged rows of one output on held-out rows.

    Args:
        level: nominal level.
        covered: share of the rows inside their intervals.
        half_width: median half-width of the intervals, in the unit of the output.
        flagged: share of the rows outside the training domain; ``expected``: that of rows like the training rows.
        regions: inside and outside the training domain, and each third of every input's range.
    """

    level: float
    covered: float
    half_width: float
    flagged: float
    expected: float
    regions: tuple[Region, ...]


def coverage_of(
    truth: Array,
    interval: tuple[Array, Array],
    inside: Mask,
    inputs: Array,
    names: Sequence[str],
    expected: float,
    level: float = LEVEL,
) -> Coverage:
    """Coverage of intervals whose middle is the prediction.

    Args:
        truth: (n,); ``interval``: lower and upper bounds, (n,) each.
        inside: rows in the training domain, (n,).
        inputs: (n, d), columns named ``names``.
        expected: share of flagged rows among rows like the training rows.
    """
    low, high = interval
    holds = (truth >= low) & (truth <= high)
    errors = 0.5 * (low + high) - truth
    groups: list[tuple[str, Mask]] = [("inside the data", inside), ("outside the data", ~inside)]
    for column, name in zip(inputs.T, names, strict=True):
        first, last = float(column.min()), float(column.max())
        third = np.clip(((column - first) / max(last - first, 1e-300) * 3.0).astype(int), 0, 2)
        groups += [(f"{name}, {where} third", third == number) for number, where in enumerate(THIRDS)]
    regions = tuple(
        Region(name, int(rows.sum()), float(holds[rows].mean()), float(np.sqrt(np.mean(errors[rows] ** 2))))
        for name, rows in groups
        if rows.any()
    )
    return Coverage(
        level=level,
        covered=float(holds.mean()),
        half_width=float(np.median(0.5 * (high - low))),
        flagged=float(np.mean(~inside)),
        expected=expected,
        regions=regions,
    )


def bootstrap_means(series: Array, seed: int, draws: int = 1000, least: int = 5) -> Array:
    """Means of ``draws`` stationary-bootstrap samples of ``series`` (n,), (draws,).

    Args:
        least: lower bound of the mean block length; 1 for independent rows.
    """
    with without_matplotlib():
        from arch.bootstrap import StationaryBootstrap, optimal_block_length

    length = float(np.nan_to_num(optimal_block_length(series)["stationary"].iloc[0], nan=1.0))
    block = int(np.clip(round(length), least, max(least, len(series) // 10)))
    bootstrap = StationaryBootstrap(block, series, seed=np.random.default_rng(seed))
    return np.asarray(bootstrap.apply(lambda x: np.mean(x, axis=0), draws), dtype=np.float64).ravel()
