"""Every recipe of a forward model on the shipped logs, evaluated as ``sysid validate`` does."""

from __future__ import annotations

from typing import Any

from sysid.datasets import Dataset
from sysid.networks import fit_forward, parse_recipe
from sysid.validate import validate_forward

RECIPES: dict[str, dict[str, Any]] = {
    "the paper's": {},
    'features = "products"': {"features": "products"},
    'rectifier = "smooth"': {"rectifier": "smooth"},
    "both": {"features": "products", "rectifier": "smooth"},
    "both, members = 4": {"features": "products", "rectifier": "smooth", "members": 4},
    'model = "chain"': {"model": "chain"},
    'model = "structured"': {"model": "structured"},
}


def reached(dataset: Dataset) -> list[dict[str, Any]]:
    """Errors against what was measured, on held-out poses and in held-out motion [m]."""
    rows = []
    for label, settings in RECIPES.items():
        model = fit_forward(dataset, parse_recipe({"forward": settings}, label))
        for entry in validate_forward(model, dataset).outputs:
            own = {key: getattr(entry.metrics, key) for key in ("count", "rmse", "p95", "max")}
            rows.append({"recipe": label, "output": entry.output, "rows": entry.rows, **own})
    return rows
