"""Joint distribution of the parameters of a plant in files: samples, ranges, and a warning about the ranges."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects.units import parameter_unit
from sysid.export.drive_module import write_csv
from sysid.plant import Plant
from sysid.plant.layout import parameter_indices
from sysid.plant.uncertainty import PlantNumber

Array = npt.NDArray[np.float64]

SAMPLES, RANGES = "posterior_samples.csv", "posterior_ranges.json"
#: Quantiles of a range that contains 95 %.
QUANTILES = (0.025, 0.975)
#: Shown with every range.
WARNING = (
    "Ranges of single parameters ignore how the parameters are correlated: independent draws from them contain combinations "
    "that the recordings exclude. Draw whole rows of posterior_samples.csv."
)


@dataclass(frozen=True)
class Posterior:
    """Samples of the uncertain parameters.

    Args:
        columns: ``effect.target[.side].parameter[component]``, (k,).
        units: of the columns.
        samples: (count, k).
    """

    columns: tuple[str, ...]
    units: tuple[str, ...]
    samples: Array

    @property
    def correlation(self) -> Array:
        """Correlations of the samples, (k, k)."""
        if len(self.columns) < 2:
            return np.eye(len(self.columns))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.nan_to_num(np.corrcoef(self.samples.T)))


def posterior(plant: Plant, count: int, seed: int) -> Posterior:
    """``count`` draws of the parameters whose uncertainty the plant knows (:meth:`sysid.plant.Plant.sample`)."""
    places, thetas = plant.uncertainty.places, plant.sample(count, seed)
    values = [thetas[:, indices_of(plant, place)[0]] for place in places]
    units = tuple(parameter_unit(p.effect, p.parameter, p.target, plant.machine) for p in places)
    return Posterior(tuple(map(_column, places)), units, np.column_stack(values) if values else np.zeros((count, 0)))


def indices_of(plant: Plant, place: PlantNumber) -> Sequence[int]:
    """Indices in the vector of a plant of one of its numbers."""
    names = plant.machine.axis_names
    groups = parameter_indices(names, place.effect, place.target, place.side, place.parameter, plant.streams)
    return groups[place.component]


def write_posterior(found: Posterior, folder: Path) -> tuple[str, ...]:
    """Write samples and ranges; returns the names of the files, none where no parameter is uncertain."""
    if not found.columns:
        return ()
    header = (f"{column} [{unit}]" for column, unit in zip(found.columns, found.units, strict=True))
    write_csv(folder / SAMPLES, header, found.samples)
    (folder / RANGES).write_text(json.dumps(ranges(found), indent=1, ensure_ascii=False), "utf-8")
    return SAMPLES, RANGES


def ranges(found: Posterior) -> dict[str, Any]:
    """Ranges that contain 95 % of each parameter, in the form of Isaac Lab's events and as standard deviations for MuJoCo."""
    low, high = np.quantile(found.samples, QUANTILES, axis=0)
    correlation = found.correlation
    strongest = np.abs(correlation - np.eye(len(found.columns))).max(initial=0.0)
    return {
        "warning": WARNING,
        "largest_correlation": float(strongest),
        "parameters": [
            {
                "name": column,
                "unit": unit,
                "mean": float(found.samples[:, k].mean()),
                "standard_deviation": float(found.samples[:, k].std()),
                "distribution_params": [float(low[k]), float(high[k])],
                "operation": "abs",
                "distribution": "uniform",
            }
            for k, (column, unit) in enumerate(zip(found.columns, found.units, strict=True))
        ],
        "correlation": correlation.tolist(),
    }


def _column(place: PlantNumber) -> str:
    side = f".{place.side}" if place.side is not None else ""
    return f"{place.effect}.{place.target}{side}.{place.parameter}{f'[{place.component}]' if place.component else ''}"
