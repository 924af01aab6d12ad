"""Coverage of the intervals of networks, and their flag for queries outside the training domain.

    .venv/bin/python pipelines/network_intervals.py       (writes reports/network_intervals/; tables: reports/networks/)

Poses of the shipped crane, uniform over its joints' ranges, tips by its kinematics, noise as its description states. Every
model is trained on 500 of them, a tenth of which for early stopping and the calibration of the intervals. It is evaluated on
2000 others, on 2000 with one joint up to a third of its range beyond its end, and, trained without a corner (boom and stick
both in the upper third), on 2000 in that corner. Five seeds each.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from committed import markdown, provenance, write_result, write_tables
from sysid.datasets import Dataset, Recording
from sysid.machine import Machine, load_machine
from sysid.networks import ForwardModel, ForwardRecipe, NetworkRecipe, fit_forward
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[1]
POSES, QUERIES, SEEDS = 500, 2000, 5
LEVELS = (0.5, 0.8, 0.9, 0.95)
#: Queries beyond the data: one joint this share of its range beyond an end.
BEYOND = (0.1, 0.33)
NOISE_TIP = 3e-4
RECIPES: dict[str, ForwardRecipe] = {
    "one perceptron": ForwardRecipe(),
    "mean of five": ForwardRecipe(members=5),
    "structured": ForwardRecipe(model="structured"),
    "chain": ForwardRecipe(model="chain"),
}
#: The corner that is left out: columns of the joints, and its share of their ranges.
CORNER, CORNER_SHARE = [1, 2], 1.0 / 3.0
REGIONS = ("central 70 % of every range", "outer 10 % of a range", "largest quarter of spread")
WIDTH, RMSE = "half width, median [m]", "rmse [m]"


def main(folder: Path, page: Path | None, seeds: int = SEEDS) -> Path:
    """Run all models and return the path of ``result.json``."""
    machine = load_machine(ROOT / "datasets" / "autolog" / "machine.toml")
    rows = {name: [evaluated(machine, recipe, seed) for seed in range(seeds)] for name, recipe in RECIPES.items()}
    result = provenance("python pipelines/network_intervals.py", 0, ("torch",))
    result |= {"poses": POSES, "asked": QUERIES, "seeds": seeds, "beyond": BEYOND, "models": rows}
    write_result(folder / "result.json", result)
    if page is not None:
        write_tables(page, tables(rows), "pipelines/network_intervals.py")
    return folder / "result.json"


def evaluated(machine: Machine, forward: ForwardRecipe, seed: int) -> dict[str, Any]:
    """One model of one seed: how often its intervals hold, by level and by region, and what it flags."""
    rng = np.random.default_rng([seed, 7])
    low, high = limits(machine)
    width = high - low

    def anywhere(count: int) -> Array:
        return np.asarray(low + width * rng.random((count, len(low))))

    model = learned(machine, forward, seed, anywhere(POSES), rng)
    inside, held = regions(model, machine, anywhere(QUERIES), rng)
    out, rows = anywhere(QUERIES), np.arange(QUERIES)
    at, up = rng.integers(0, len(low), QUERIES), rng.random(QUERIES) < 0.5
    share = BEYOND[0] + (BEYOND[1] - BEYOND[0]) * rng.random(QUERIES)
    out[rows, at] = np.where(up, high[at] + share * width[at], low[at] - share * width[at])
    beyond, held_beyond = regions(model, machine, out, rng)

    def in_corner(q: Array) -> npt.NDArray[np.bool_]:
        return np.asarray(np.all(q[:, CORNER] > (low + (1.0 - CORNER_SHARE) * width)[CORNER], axis=1))

    poses = anywhere(2 * POSES)
    blind = learned(machine, forward, seed, poses[~in_corner(poses)][:POSES], rng)
    corner = anywhere(QUERIES)
    corner[:, CORNER] = (high - CORNER_SHARE * width * rng.random(corner.shape))[:, CORNER]
    corner_inside, held_corner = regions(blind, machine, corner, rng)
    return {
        "like": {"flagged": 1.0 - inside, "held": held},
        "beyond": {"flagged": 1.0 - beyond, "held": held_beyond},
        "corner": {"flagged": 1.0 - corner_inside, "held": held_corner},
    }


def learned(machine: Machine, forward: ForwardRecipe, seed: int, q: Array, rng: np.random.Generator) -> ForwardModel:
    """A model of the poses ``q``."""
    dataset = Dataset.of(machine, (measured(machine, q, rng),))
    return fit_forward(dataset, NetworkRecipe(seed=seed, forward=forward))


def regions(model: ForwardModel, machine: Machine, q: Array, rng: np.random.Generator) -> tuple[float, dict[str, Any]]:
    """Share of ``q`` inside the data; shares of measured tips inside their intervals, by level, flag and region."""
    poses = measured(machine, q, rng)
    joints = np.column_stack([poses.values(signal) for signal in model.joints])
    tip = np.column_stack([poses.values(signal) for signal in point_signals("ee")])
    inside = model.inside(joints)
    low, high = limits(machine)
    central = np.all(np.abs(q - 0.5 * (low + high)) <= 0.35 * (high - low), axis=1)
    edge = np.any(np.abs(q - 0.5 * (low + high)) >= 0.45 * (high - low), axis=1)
    wide = model.spread(joints).max(axis=1)
    groups = {
        "all": np.ones(len(q), dtype=bool), "not flagged": inside, "flagged": ~inside,
        **dict(zip(REGIONS, (central, edge, wide >= np.quantile(wide, 0.75)), strict=True)),
    }  # fmt: skip
    found: dict[str, Any] = {}
    for level in LEVELS:
        lower, upper = model.predict_interval(joints, level)
        holds = (tip >= lower) & (tip <= upper)
        found[f"{level:g}"] = {name: float(holds[rows].mean()) if rows.any() else None for name, rows in groups.items()}
    lower, upper = model.predict_interval(joints, LEVELS[-1])
    found[WIDTH] = float(np.median(0.5 * (upper - lower)))
    errors = model.predict(joints) - tip
    found[RMSE] = {name: float(np.sqrt(np.mean(errors[rows] ** 2))) if rows.any() else None for name, rows in groups.items()}
    return float(inside.mean()), found


def limits(machine: Machine) -> tuple[Array, Array]:
    """Ends of every joint, (n_axes,) each."""
    ends = np.array([axis.limits for axis in machine.axes], dtype=np.float64)
    return ends[:, 0], ends[:, 1]


def measured(machine: Machine, q: Array, rng: np.random.Generator) -> Recording:
    """Static poses at true joint values ``q`` (n, n_axes), as its sensors would say."""
    kinematics = machine.kinematics()
    assert kinematics is not None
    signals = [axis_signal(axis, "joint") for axis in machine.axis_names]
    table = {"time": 4.0 * np.arange(len(q))}
    for signal, column in zip(signals, q.T, strict=True):
        table[signal] = column + rng.normal(0.0, machine.noise.get(signal, 0.0), len(q))
    for signal, column in zip(point_signals("ee"), kinematics.tip_position(q).T, strict=True):
        table[signal] = column + rng.normal(0.0, machine.noise.get(signal, NOISE_TIP), len(q))
    return Recording("poses", pd.DataFrame(table), 100.0, kind="poses")


def tables(models: Mapping[str, list[dict[str, Any]]]) -> str:
    """Two Markdown tables: how often intervals hold, and what is flagged."""
    level = f"{LEVELS[-1]:g}"

    def mean(runs: list[dict[str, Any]], *path: str, factor: float = 100.0) -> str:
        values = []
        for run in runs:
            value: Any = run
            for key in path:
                value = value[key]
            values += [value] if value is not None else []
        return f"{factor * float(np.mean(values)):.{1 if factor == 100.0 else 2}f}" if values else "–"

    names = ("not flagged", "flagged", *REGIONS)
    levels = [f"{100.0 * share:g} %" for share in LEVELS]
    header = ["coverage [%] at a nominal level of", *levels, *(f"{levels[-1]}, {name}" for name in names)]
    rows = [
        [title, *(mean(runs, "like", "held", f"{share:g}", "all") for share in LEVELS)]
        + [mean(runs, "like", "held", level, name) for name in names]
        + [mean(runs, "like", "held", WIDTH, factor=1e3)]
        for title, runs in models.items()
    ]
    first = markdown([*header, f"half-width at {levels[-1]} [mm]"], rows)
    kinds = {"like": "as in training", "beyond": "beyond a joint's range", "corner": "in the omitted corner"}
    whats = ("flagged [%],", "RMSE [mm],", f"coverage at {levels[-1]} [%],")
    header = ["poses", *(f"{what} {kind}" for kind in kinds.values() for what in whats)]
    rows = [
        [title]
        + [
            cell
            for kind in kinds
            for cell in (
                mean(runs, kind, "flagged"),
                mean(runs, kind, "held", RMSE, "all", factor=1e3),
                mean(runs, kind, "held", level, "all"),
            )
        ]
        for title, runs in models.items()
    ]
    return f"{first}\n\n{markdown(header, rows)}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=ROOT / "reports" / "network_intervals")
    parser.add_argument("--page", type=Path, default=ROOT / "reports" / "networks" / "README.md")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    given = parser.parse_args()
    main(given.folder, given.page, given.seeds)
