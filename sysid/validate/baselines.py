"""What a network has to beat: polynomials, the nearest recorded row, and for the forward network the URDF."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset
from sysid.networks.split import Rows

Array = npt.NDArray[np.float64]


def learned(fit_inputs: Array, fit_outputs: Array, inputs: Array) -> dict[str, Array]:
    """Baselines fitted on the rows that the network learned from: name → predictions at ``inputs``, (n, n_out)."""
    from sklearn.linear_model import LinearRegression
    from sklearn.neighbors import KNeighborsRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import PolynomialFeatures, StandardScaler

    models: dict[str, Any] = {
        f"polynomial, degree {degree}": make_pipeline(StandardScaler(), PolynomialFeatures(degree), LinearRegression())
        for degree in (3, 5)
    }
    models["nearest neighbour"] = make_pipeline(StandardScaler(), KNeighborsRegressor(n_neighbors=1))
    return {name: np.asarray(model.fit(fit_inputs, fit_outputs).predict(inputs)) for name, model in models.items()}


def urdf_kinematics(dataset: Dataset, rows: Rows, joints: int) -> Array | None:
    """End effector by the machine's URDF at the first ``joints`` columns of ``rows``, (n, 3) [m]; None without one."""
    kinematics = dataset.machine.kinematics()
    return None if kinematics is None else kinematics.tip_position(rows.values[:, :joints])
