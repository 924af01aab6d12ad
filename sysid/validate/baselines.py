"""Baselines of networks: polynomials, boosted trees, nearest neighbour, and the geometry where it is known."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset
from sysid.machine.description import Linkage
from sysid.machine.linkage import TriangleLinkage

Array = npt.NDArray[np.float64]
#: Inputs (n, d) → outputs (n,) or (n, d_out).
Predict = Callable[[Array], Array]


def baseline_models(inputs: Array, outputs: Array) -> dict[str, Predict]:
    """Name → prediction of baselines that are fitted on the network's fit rows, (n, d) → (n,) or (n, d_out).

    The last fits are cached, since versions that are compared have the same fit rows.
    """
    return dict(_fitted(inputs.tobytes(), inputs.shape, outputs.tobytes(), outputs.shape))


@functools.lru_cache(maxsize=16)
def _fitted(inputs: bytes, in_shape: tuple[int, ...], outputs: bytes, out_shape: tuple[int, ...]) -> dict[str, Predict]:
    from sklearn.ensemble import GradientBoostingRegressor
    from sklearn.linear_model import LinearRegression
    from sklearn.multioutput import MultiOutputRegressor
    from sklearn.neighbors import KNeighborsRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import PolynomialFeatures, StandardScaler

    models: dict[str, Any] = {
        f"polynomial, degree {degree}": make_pipeline(StandardScaler(), PolynomialFeatures(degree), LinearRegression())
        for degree in (3, 5)
    }
    x, y = np.frombuffer(inputs).reshape(in_shape), np.frombuffer(outputs).reshape(out_shape)
    boosted = GradientBoostingRegressor(n_estimators=200, max_depth=4, subsample=0.7, random_state=0)
    models["gradient boosting"] = boosted if y.ndim == 1 else MultiOutputRegressor(boosted)
    models["nearest neighbour"] = make_pipeline(StandardScaler(), KNeighborsRegressor(n_neighbors=1))
    return {name: _predict(model.fit(x, y)) for name, model in models.items()}


def linkage_geometry(displacements: Array, joints: Array, to_joint: bool) -> Predict:
    """The triangle of two levers and a cylinder (law of cosines), its four lengths and angles fitted to rows (n,).

    The residual is that of the joint for ``to_joint``, else of the displacement. For another linkage, such as a four-bar drive,
    the result is the best triangle. The last fits are cached, as above.
    """
    linkage = _triangle(displacements.tobytes(), joints.tobytes(), to_joint)
    return lambda x: linkage.joint(x[:, 0]) if to_joint else linkage.displacement(x[:, 0])


@functools.lru_cache(maxsize=16)
def _triangle(cylinder: bytes, joint: bytes, to_joint: bool) -> TriangleLinkage:
    from scipy.optimize import least_squares

    displacements, joints = np.frombuffer(cylinder), np.frombuffer(joint)
    stroke = float(np.ptp(displacements))
    fits: list[tuple[float, TriangleLinkage]] = []
    for sense in (1, -1):
        for lever in (0.7, 2.0):
            # Start with the lever angle around a right angle, where a triangle is nearly linear.
            middle = 0.5 * (joints.min() + joints.max())
            a, b = lever * stroke, 2.0 * lever * stroke
            start = np.array([a, b, 0.5 * np.pi * sense - middle, np.hypot(a, b) - float(displacements.mean())])

            def triangle(v: Array, sense: int = sense) -> TriangleLinkage:
                a, b, offset, retracted = map(float, v)
                return TriangleLinkage(Linkage("triangle", abs(a), abs(b), offset, retracted, 1 if sense > 0 else -1))

            def errors(v: Array, triangle: Any = triangle) -> Array:
                found = triangle(v)
                return np.asarray(
                    found.joint(displacements) - joints if to_joint else found.displacement(joints) - displacements
                )

            fit = least_squares(errors, start, x_scale=np.maximum(np.abs(start), 1e-2), max_nfev=60)
            fits.append((float(fit.cost), triangle(fit.x)))
    return min(fits, key=lambda found: found[0])[1]


def urdf_kinematics(dataset: Dataset) -> Predict | None:
    """End effector by the machine's URDF, joints (n, n_axes) → (n, 3) [m]; None without one."""
    kinematics = dataset.machine.kinematics()
    return None if kinematics is None else kinematics.tip_position


def _predict(model: Any) -> Predict:
    return lambda inputs: np.asarray(model.predict(inputs), dtype=np.float64)
