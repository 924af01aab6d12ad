"""Error metrics of a prediction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError

Array = npt.NDArray[np.float64]


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
