"""The gradient of a function of whitened columns is that of finite differences, with gaps, restarts and both kinds of stage."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from sysid.gap.likelihood.adjoint import gradient_of
from sysid.gap.likelihood.disturbance import Disturbance, Filter, filter_of

Array = npt.NDArray[np.float64]
#: Noise, disturbance at rest and in motion, correlation time, the output's own error, its correlation time.
NUMBERS = np.log([0.1, 0.1, 0.2, 0.5, 0.1, 0.1])


@pytest.mark.parametrize("integrates", [True, False])
def test_the_gradient_is_that_of_finite_differences(integrates: bool) -> None:
    rng = np.random.default_rng(0)
    columns, weights = rng.standard_normal((2, 300, 5))
    activity, present = np.abs(rng.standard_normal(300)), rng.random(300) > 0.1
    restart = np.zeros(300, dtype=bool)
    restart[[0, 120]] = True

    def filters(z: Array) -> Filter:
        found = Disturbance(*map(float, np.exp(z)))
        return filter_of(found, np.full(300, 0.04), activity, present, restart, np.zeros(300), 1.0, integrates)

    def value(z: Array) -> tuple[float, Array]:
        out = np.empty(columns.shape)
        found = filters(z)
        found.whiten(columns, out)
        return float((weights * out).sum() + 0.1 * (out**3).sum()) + found.log_scale, out

    slope = weights + 0.3 * value(NUMBERS)[1] ** 2
    step = 1e-5 * np.eye(6)
    expected = [(value(NUMBERS + each)[0] - value(NUMBERS - each)[0]) / 2e-5 for each in step]
    assert gradient_of(columns, slope, filters(NUMBERS), filters, NUMBERS) == pytest.approx(
        np.array(expected), rel=2e-4, abs=1e-6
    )
    if integrates:
        assert np.all(np.abs(expected) > 1.0)  # every number matters here
