"""Result of a calibration ↔ entries of the structure file of a model version."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from sysid.networks.calibration import Calibration
from sysid.networks.calibration_models import ComparedModel
from sysid.networks.geometry_evidence import Support


def put_result(calibration: Calibration) -> dict[str, Any]:
    """Entries for JSON: combinations, parameters of the model, their supports, comparison with other models."""
    keys = [parameter.key for parameter in calibration.geometry.parameters]
    supports = calibration.supports or {}
    return {
        "open": [[list(part) for part in combination] for combination in calibration.non_identifiable],
        "free": [key for key, free in zip(keys, calibration.estimated, strict=True) if free],
        "supports": {keys[index]: [support.gain, support.alternative] for index, support in supports.items()},
        "models": [model.to_json() for model in calibration.models],
    }


def take_result(entry: Mapping[str, Any], calibration: Calibration) -> Calibration:
    """The calibration with the entries of :func:`put_result`; a version of an earlier release has only the combinations."""
    keys = [parameter.key for parameter in calibration.geometry.parameters]
    combinations = tuple(tuple((str(key), float(weight)) for key, weight in part) for part in entry["open"])
    free = np.isin(keys, entry["free"]) if "free" in entry else calibration.estimated
    supports = {keys.index(key): Support(float(gain), other) for key, (gain, other) in entry.get("supports", {}).items()}
    models = tuple(ComparedModel.from_json(model) for model in entry.get("models", ()))
    return replace(calibration, non_identifiable=combinations, free=free, supports=supports, models=models)
