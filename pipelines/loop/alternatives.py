"""What the named repair is compared with: a fixed structure fitted without names, and the plant of the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from loop.models import register_plant
from loop.rounds import PATHS, Site, deploy
from loop.score import flown
from sysid.datasets import Dataset
from sysid.errors import SettingsError
from sysid.machine import KnownEffect
from sysid.plant import Plant, free_run

Array = npt.NDArray[np.float64]

#: The fixed structure of every axis: effect, parameter, and the bounds of the fit.
STRUCTURE = (
    ("input_delay", "delay", (0.0, 0.3)),
    ("first_order_lag", "time_constant", (1e-3, 0.3)),
    ("gain_error", "ratio", (0.05, 2.0)),
)
#: Finite differences of the fit [s, s, 1]: above the kinks of a sampled delay.
DIFFERENCES = np.array([2e-3, 2e-3, 5e-3])


def fixed_structure(plant: Plant, dataset: Dataset) -> Plant:
    """Dead time, lag and gain of every axis by least squares on the free runs of the recordings, everything else nominal.

    The held-out recordings are left out, as in the gap workflow.
    """
    recordings = [each for each in dataset.recordings if dataset.splits[each.name] != "held_out"]
    for axis in plant.machine.axes:

        def fitted(values: Array, axis: Any = axis, base: Plant = plant) -> Plant:
            for (name, parameter, _), value in zip(STRUCTURE, values, strict=True):
                base = base.with_effect(KnownEffect(name, axis.name, {parameter: float(value)}))
            return base

        def residuals(values: Array, axis: Any = axis) -> Array:
            parts = []
            for recording in recordings:
                error = free_run(fitted(values), recording)[axis.driven].to_numpy() - recording.values(axis.driven)
                parts.append(error[np.isfinite(error)])
            return np.concatenate(parts)

        low, high = (np.array(ends) for ends in zip(*(bounds for *_, bounds in STRUCTURE), strict=True))
        start = np.clip([_value(plant, name, axis.name, parameter) for name, parameter, _ in STRUCTURE], low, high)
        steps = DIFFERENCES / np.maximum(start, DIFFERENCES)
        found = least_squares(residuals, start, bounds=(low, high), diff_step=steps, x_scale=high - low, max_nfev=20)
        plant = fitted(found.x)
    return plant


def _value(plant: Plant, name: str, target: str, parameter: str) -> float:
    known = plant.effect(name, target)
    neutral = 1.0 if parameter == "ratio" else 0.0
    return float(np.atleast_1d(known.parameters[parameter])[0]) if known is not None else neutral


def true_plant(nominal: Plant, hidden: Sequence[Mapping[str, Any]], parked: Mapping[str, float]) -> Plant:
    """The nominal plant with the hidden effects.

    Args:
        parked: joints of the parked machine, where the backlash of a cylinder [m] is converted to that of its joint [rad].
    """
    plant = nominal
    for each in hidden:
        name, target, parameters = str(each["name"]), str(each["target"]), dict(each["parameters"])
        if name == "backlash" and target in plant.linkages:
            linkage, width = plant.linkages[target], parameters["width"]
            middle = float(linkage.displacement(np.array([parked[target]]))[0])
            ends = linkage.joint(np.array([middle - 0.5 * width, middle + 0.5 * width]))
            parameters["width"] = float(abs(ends[1] - ends[0]))
        side = "drive" if name == "backlash" else None
        plant = plant.with_effect(KnownEffect(name, target, parameters, side))
    return plant


def deployed(site: Site, plant: Plant, name: str) -> dict[str, Any]:
    """Figures of the paths under the controller of ``plant``; its logs are not those of the loop.

    A path that the runner refuses has no figures, and the reason in ``why``.
    """
    plant = replace(plant, reference=register_plant(site.workspace.models, plant))
    try:
        return flown(*deploy(site, plant, site.folder / f"flights-{name}"))
    except SettingsError as error:
        refused = {path: {"ended": "refused", "why": error.found} for path in dict.fromkeys(PATHS)}
        return {**refused, "simulation": refused}
