"""Coverage of 95 % intervals under model error, on the simulated test bench; reports/interval_coverage/README.md.

    .venv/bin/python pipelines/interval_coverage_bench.py [--repeats 10]

A baseline is fitted to the bench without the feature and without noise; then the feature is switched on. The *true* parameters
are those of ``bench_agreement.py``: the best fit without noise, all others unchanged. Recordings with noise and a disturbed
flow are fitted in the right structure, with free nuisances as in every fit. The remaining residual is given in noise floors.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from agreement.fitting import FIRST_GUESS
from agreement.machines import MACHINES, STREAMS, description, recipe_of, record
from agreement.rows import ROWS, Row
from bench_agreement import RESULT as AGREEMENT
from committed import markdown, write_tables
from interval_coverage import NOISE, PAGE, SEED, STILL, Family, candidates_of, nuisances, problem_of, sensed
from simulated_bench.recipe import BenchRecipe
from sysid.datasets import Recording
from sysid.effects.effect import Stage
from sysid.gap.data import Data
from sysid.gap.fit import Fit, fit_candidates, spread_of
from sysid.gap.intervals import known_of
from sysid.gap.prepare.noise import problem_floor
from sysid.gap.problem import Problem
from sysid.machine import KnownEffect
from sysid.plant import Plant, compile_plant, nominal_plant

Array = npt.NDArray[np.float64]
#: Relative flow fluctuation of 1 s, and lengths of recordings [s]: those with noise, and those that the truth is from.
DISTURBANCE, SECONDS, LONG = 0.005, 45.0, 60.0
COMMAND = ("valve_deadband", "valve_hysteresis", "gain_curve", "flow_saturation", "command_rate_limit", "first_order_lag")


def stage_of(row: Row) -> Stage | None:
    """Where the effect shows; None for rows that are not looked at."""
    if row.effect in COMMAND and row.target == "boom":
        return "command"
    if row.effect == "backlash" and row.target == "slew" and row.side is None:
        return "command"
    if row.effect == "gripper_sway":
        return "tool"
    return "force" if row.effect in ("coulomb_friction", "viscous_friction") else None


@dataclass(frozen=True)
class Outcome:
    """One parameter of a row: true values, shares of intervals that hold it, errors and half widths relative to it."""

    label: str
    parameter: str
    true: float
    covers: float
    error: float
    half: float
    left: float


def best_fit(row: Row) -> list[float]:
    """Parameters of the row in the committed result of ``bench_agreement.py``."""
    parameters = {key: list(value) if isinstance(value, tuple) else value for key, value in row.feature.items()}
    under = {key: list(value) if isinstance(value, tuple) else value for key, value in row.base.items()}
    for entry in json.loads(AGREEMENT.read_text("utf-8"))["rows"]:
        same = (entry["effect"], entry["target"], entry["machine"]) == (row.effect, row.target, row.machine_name)
        if same and entry["feature"] == parameters and entry["base"] == under:
            return [float(value) for value in entry["parameters"].values()]
    raise KeyError(row.effect)


def machines_of(row: Row) -> tuple[BenchRecipe, BenchRecipe]:
    return recipe_of(row.machine_name, dict(row.base)), recipe_of(row.machine_name, {**row.base, **row.feature})  # type: ignore[return-value]


def taken(machine: BenchRecipe, row: Row, seed: int, seconds: float, count: int) -> list[Recording]:
    programs = (*row.programs, "operator", "steps")
    if row.machine_name == "slide":
        seconds = 0.25 * seconds
    return [
        replace(record(machine, programs[k % len(programs)], seed + k, seconds), name=f"take-{k + 1}") for k in range(count)
    ]


def data_of(family: Family, plant: Plant, recordings: Sequence[Recording]) -> tuple[Problem, Data]:
    problem = problem_of(family, compile_plant(plant), recordings)
    sigma = problem_floor(problem, plant.vector(), recordings, NOISE, 0)
    return problem, Data(problem, recordings, sigma)


def outcome(row: Row, repeats: int) -> list[Outcome]:
    """Fit the baseline, then the truth, then noisy recordings."""
    stage = stage_of(row)
    assert stage is not None
    guess = {k: list(v) if isinstance(v, tuple) else v for k, v in row.guess.items()}
    side = row.side or ("drive" if row.effect == "backlash" else None)
    family = Family(stage, KnownEffect(row.effect, row.target, guess, side))  # type: ignore[arg-type]
    plain, real = machines_of(row)
    names = MACHINES[row.machine_name].baseline if stage in ("command", "force") else ()
    before = nominal_plant(description(plain), streams=STREAMS if isinstance(plain, BenchRecipe) else None)
    for name in names:
        values = {key: float(value) for key, value in FIRST_GUESS[name].items()}  # type: ignore[arg-type]
        before = before.with_effect(KnownEffect(name, row.target, values))
    if names:
        problem, data = data_of(family, before, taken(plain, row, 101, LONG, 3))
        theirs = [c for c in candidates_of(family, before, problem, names, row.target) if c.effect.name in names]
        fit = fit_candidates(data, before.vector(), theirs, [np.array([u.nominal for c in theirs for u in c.unknowns])])
        for candidate in theirs:
            before = before.with_effect(candidate.instance(fit.values_of(candidate)))
    true = np.array(best_fit(row))
    found, left = [], []
    for k in range(repeats):
        rng = np.random.default_rng([SEED, k])
        machine = disturbed(real, row) if stage == "command" else real
        clean = taken(machine, row, 1000 + 10 * k, SECONDS, 3)
        noisy = [sensed(each, family, STILL[0], rng) for each in clean]
        fit, data = fitted(family, before, noisy, row, list(true))
        known = known_of(data, before.vector(), fit, NOISE, k)
        found.append(np.column_stack([known.fit.values, known.limits])[: len(true)])
        left.append(spread_of(data.residuals(known.fit.theta[None])))
    table = np.array(found)
    label = f"`{row.effect}` on {row.target}, {row.machine_name}"
    rows = []
    for j, key in enumerate(u.key for u in fit.unknowns[: len(true)]):
        value, low, high = table[:, j].T
        covers = float(np.mean((low <= true[j]) & (true[j] <= high)))
        error, half = (float(np.median(v) / abs(true[j])) for v in (np.abs(value - true[j]), 0.5 * (high - low)))
        rows.append(Outcome(label, key, float(true[j]), covers, error, half, float(np.median(left))))
    return rows


def disturbed(machine: BenchRecipe, row: Row) -> BenchRecipe:
    axis = machine.axes[row.target]
    return replace(
        machine, axes={**machine.axes, row.target: replace(axis, valve=replace(axis.valve, disturbance=DISTURBANCE))}
    )


def fitted(family: Family, plant: Plant, recordings: Sequence[Recording], row: Row, start: list[float]) -> tuple[Fit, Data]:
    problem, data = data_of(family, plant, recordings)
    candidates = candidates_of(family, plant, problem, nuisances(problem), row.target)
    known = [u.nominal for c in candidates[1:] for u in c.unknowns]
    return fit_candidates(data, plant.vector(), candidates, [np.array([*start, *known])]), data


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    rows = [row for row in ROWS if stage_of(row) is not None]
    with ProcessPoolExecutor(args.workers) as pool:
        found = [each for part in pool.map(outcome, rows, [args.repeats] * len(rows)) for each in part]
    head = (
        "effect and machine",
        "parameter",
        "best fit without noise",
        "covers",
        "median error",
        "half width",
        "residual, floors",
    )
    lines = [
        (r.label, r.parameter, f"{r.true:.4g}", f"{r.covers:.0%}", f"{r.error:.2%}", f"{r.half:.2%}", f"{r.left:.2f}")
        for r in found
    ]
    text = f"{markdown(head, lines, 'll')}\n\nAll of them: {np.mean([r.covers for r in found]):.0%}."
    print(text)
    write_tables(PAGE, text, "pipelines/interval_coverage_bench.py")


if __name__ == "__main__":
    main()
