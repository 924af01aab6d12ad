"""The regression of static poses against dense formulas, and its cost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from sysid.gap.arm.pose_rows import KINDS, tangents_of
from sysid.gap.likelihood.gaussian_regression import GaussianRegression, Sizes
from sysid.gap.likelihood.stage import Prior
from tests.helpers.pose_sets import Arm, Hidden, tips


@given(st.integers(0, 2**31), st.floats(0.1, 5.0), st.floats(1e-3, 1.0))
@settings(max_examples=25, deadline=None)
def test_evidence_is_the_density_of_the_rows(seed: int, noise: float, tau: float) -> None:
    """With known widths (none is estimated) it is that of a normal vector with all coefficients marginalised."""
    draw = np.random.default_rng(seed)
    X, errors, y = draw.normal(size=(12, 4)), draw.normal(size=(12, 3)), draw.normal(size=12)
    width = draw.uniform(0.2, 2.0, 4)
    prior = Prior(np.zeros(4), width, np.full(4, -1e9), np.full(4, 1e9), width)
    sizes = Sizes(np.array([tau]), noise)
    regression = GaussianRegression(y, X, errors, np.zeros(3, dtype=np.int64), prior, np.zeros(4), 12, sizes)
    used = np.array([0, 2])
    covariance = noise**2 * np.eye(12) + tau**2 * errors @ errors.T + X[:, used] @ np.diag(width[used] ** 2) @ X[:, used].T
    expected = multivariate_normal(np.zeros(12), covariance).logpdf(y) + 6.0 * np.log(2.0 * np.pi)
    assert regression.posterior(used).evidence == pytest.approx(float(expected), rel=1e-7, abs=1e-7)


def test_tilts_of_the_axes_are_among_the_errors() -> None:
    """The tip of an arm with a slightly tilted link moves by a combination of the columns."""
    arm = Arm("zyyx", Arm().links[:4], Arm().masses[:4])
    kinematics = arm.machine(1e-4).kinematics()
    assert kinematics is not None
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (40, 4))
    tangents, kind = tangents_of(kinematics, q)
    small = 1e-6
    moved = (tips(arm, Hidden(tilt={1: (small, 0.0, 0.0)}), q) - tips(arm, Hidden(), q)) / small
    columns = tangents[:, :, kind == KINDS.index("tilt")].reshape(120, -1)
    left = moved.ravel() - columns @ np.linalg.lstsq(columns, moved.ravel(), rcond=None)[0]
    assert np.linalg.norm(left) < 0.02 * np.linalg.norm(moved)
