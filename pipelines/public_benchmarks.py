"""Public benchmarks of nonlinear system identification, by the protocol of the package `nonlinear-benchmarks`.

    .venv/bin/python pipelines/public_benchmarks.py DATA [--publish]    (files in DATA/emps and DATA/cascaded_tanks)

datasets/NAME/README.md says where the files come from. A model is fitted to the identification record alone and simulates the
test record from its input; its start is estimated from the first samples, the rest is scored. `sysid gap` works on the two
halves of the identification record. See reports/public_benchmarks/README.md.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from committed import ROOT, markdown, provenance, write_result, write_tables
from free_run_residual import Shape, fit_free_run
from sysid.cli.output import PipelineProgress, Printer, write_json
from sysid.datasets import Dataset, Recording, Role, ingest
from sysid.gap import find_gap
from sysid.gap.result import GapResult
from sysid.machine import KnownEffect
from sysid.plant import Model, Plant, compile_plant, free_run, nominal_plant
from sysid.plant.residual import ResidualStage, input_names
from sysid.progress import Progress
from sysid.workspace import Workspace, open_workspace

Array = npt.NDArray[np.float64]
FOLDER = ROOT / "reports" / "public_benchmarks"
#: Plants drawn from the uncertainty of the named values, and the percentiles of their test error that are reported.
DRAWS, SEED, PERCENTILES = 200, 67, (5, 50, 95)
#: Relative step of the derivatives by the values: a free run with dry friction has kinks that a smaller one falls into.
STEP = 1e-3
#: Which half of the identification record is fitted and which selects.
HALVES: dict[str, tuple[Role, Role]] = {"first half fitted": ("fit", "select"), "second half fitted": ("select", "fit")}

FORGIONE = "Forgione, Piga 2021, *Continuous-time system identification with neural networks*, Eur. J. Control 59"
CHAMPNEYS = "Champneys et al. 2024, arXiv 2405.10779"
DYNONET = "Forgione, Piga 2021, *dynoNet*, arXiv 2006.02250"


@dataclass(frozen=True)
class Published:
    """A published error on the test record; ``remark`` where it is not quite the same figure."""

    model: str
    error: float
    source: str
    remark: str = ""


@dataclass(frozen=True)
class Benchmark:
    """One set and its protocol.

    Args:
        folder: of the recipe in ``datasets/`` and of the files in DATA.
        identification, test: recordings of the recipe.
        signal: the output. ``scale``: of a shown error, in ``unit``.
        window: first samples of the test output from which the start is estimated; they are not scored.
        literature: plants with published values, by model.
        described: value of the description that is estimated as well, as an effect that changes nothing.
        network: of the free run: stage, bound (SI), samples between two updates, inputs.
        published: errors on the test record.
    """

    folder: str
    identification: str
    test: str
    signal: str
    window: int
    scale: float
    unit: str
    published: tuple[Published, ...]
    literature: Mapping[str, tuple[KnownEffect, ...]]
    network: tuple[ResidualStage, float, int, tuple[str, ...]]
    described: KnownEffect | None = None

    @property
    def axis(self) -> str:
        return self.signal.partition(".")[0]


def friction(coulomb: Mapping[str, float], viscous: Mapping[str, float], bias: float) -> tuple[KnownEffect, ...]:
    """Friction of the EMPS' slide and its offset."""
    forces = {"coulomb_friction": coulomb, "viscous_friction": viscous, "load_bias": {"force": bias}}
    return tuple(KnownEffect(name, "slide", dict(parameters)) for name, parameters in forces.items())


BENCHMARKS = (
    Benchmark(
        folder="emps", identification="identify", test="pulses", signal="slide.joint", window=20, scale=1e3, unit="mm",
        literature={
            "least squares of the force (Janot, Gautier, Brunot 2019), one value each": friction(
                {"force": 20.394}, {"coefficient": 203.50}, -3.165
            ),
            "least squares of the force (Janot, Gautier, Brunot 2019), by direction": friction(
                {"positive": 20.14, "negative": 20.63}, {"positive": 166.7, "negative": 240.4}, 0.0
            ),
        },
        described=KnownEffect("inertia_error", "slide", {"ratio": 1.0}),
        network=("force", 5.0, 20, ("slide.joint", "speed of slide")),
        published=(
            Published("dynoNet, as cited", 0.452, CHAMPNEYS, "not in the paper that is cited, which has 2.64"),
            Published("dynoNet", 2.64, DYNONET, "its committed script reads the identification file for the test as well"),
            Published("polynomial NARX", 5.17, CHAMPNEYS),
            Published("linear state space", 5.53, CHAMPNEYS),
            Published("linear ARX", 12.6, CHAMPNEYS),
            Published("LSTM", 74.1, CHAMPNEYS),
            Published("recurrent network", 89.2, CHAMPNEYS),
            Published("GRU", 220.0, CHAMPNEYS),
        ),
    ),
    Benchmark(
        folder="cascaded_tanks", identification="estimation", test="test", signal="level.joint", window=50, scale=1.0, unit="V",
        literature={},
        network=("command", 2.0, 2, ("level.command", "level.joint")),
        published=(
            Published("grey box with overflow (Rogers et al. 2017)", 0.18, FORGIONE),
            Published("grey box (Worden et al. 2018), as cited", 0.191, CHAMPNEYS),
            Published("neural network with the structure of the tanks", 0.33, FORGIONE),
            Published("nonlinear state space (Relan et al. 2017)", 0.34, FORGIONE),
            Published("GRU", 0.396, CHAMPNEYS),
            Published("polynomial NARX", 0.413, CHAMPNEYS),
            Published("state space with Gaussian-process prior (Svensson, Schön 2017)", 0.45, FORGIONE),
            Published("LSTM", 0.490, CHAMPNEYS),
            Published("Volterra (Birpoutsoukis et al. 2018)", 0.54, FORGIONE),
            Published("linear state space", 0.588, CHAMPNEYS),
            Published("best linear approximation (Relan et al. 2017)", 0.75, FORGIONE),
        ),
    ),
)  # fmt: skip


def main(raw: Path, workspace: Path) -> Path:
    """Run every set whose folder is in ``raw`` and return the path of ``<workspace>/public_benchmarks/result.json``."""
    place, out, folder = open_workspace(workspace), Printer(), workspace / "public_benchmarks"
    folder.mkdir(parents=True, exist_ok=True)
    station = PipelineProgress(out)
    found = {}
    for benchmark in BENCHMARKS:
        if not (raw / benchmark.folder).is_dir():
            out.line(f"{benchmark.folder}: left out, {raw / benchmark.folder} is not here")
            continue
        found[benchmark.folder] = run(benchmark, raw, place, station)
        rows = [(row["model"], *shown(row), row["remark"]) for row in found[benchmark.folder]["rows"]]
        out.table(("model", f"identification [{benchmark.unit}]", f"test [{benchmark.unit}]", "remark"), rows, right=(1, 2))
    path = folder / "result.json"
    write_json(path, {"benchmarks": found, "seconds": station.seconds})
    out.block(f"Figures  {path}")
    return path


def run(benchmark: Benchmark, raw: Path, place: Workspace, station: PipelineProgress) -> dict[str, Any]:
    """Every row of one set, what the workflow says, and how far its uncertainty moves the error."""
    with station(f"{benchmark.folder}: ingest") as progress:
        whole = whole_records(benchmark, raw / benchmark.folder, place, progress)
    nominal = nominal_plant(whole.machine)
    gaps, plants = {}, {}
    for name, roles in HALVES.items():
        dataset = halves(whole, benchmark, roles)
        with station(f"{benchmark.folder}: gap, {name}") as progress:
            gaps[name] = find_gap(dataset, nominal, place.models, add=True, carry=True, progress=progress)
        plants[name] = place.plant(dataset, gaps[name].plant_after) if gaps[name].plant_after else nominal

    named = replace(plants["first half fitted"], residuals=())
    rows = [
        scored("described simulation", nominal, whole, benchmark),
        scored("effects named by `sysid gap`", named, whole, benchmark, effects_text(named)),
    ]
    with station(f"{benchmark.folder}: values by the free run"):
        refined = fitted(named, whole.recording(benchmark.identification), benchmark)
        rows.append(scored("the same, values by the free run", refined, whole, benchmark, effects_text(refined)))
        structure = named
        if benchmark.described is not None:
            structure = named.with_effect(benchmark.described)
            refined = fitted(structure, whole.recording(benchmark.identification), benchmark)
            text = effects_text(refined)
            rows.append(scored(f"the same, with {benchmark.described.name}", refined, whole, benchmark, text))
        best = fitted(structure, whole.recording(benchmark.test), benchmark)
    with station(f"{benchmark.folder}: network by the free run") as progress:
        rows.append(network_row(refined, whole, benchmark, progress))
    for name, gap in gaps.items():
        (carried,) = gap.carried or (None,)
        title = f"named effects and residual network of `sysid gap --carry`, {name}"
        if carried is not None and carried.accepted:
            rows.append(scored(title, plants[name], whole, benchmark, carried.text))
        else:
            text = carried.text if carried is not None else "no unnamed residual"
            rows.append({"model": title, "identification": None, "test": None, "remark": f"refused: {text}"})
    for name, effects in benchmark.literature.items():
        plant = nominal
        for effect in effects:
            plant = plant.with_effect(effect)
        rows.append(scored(name, plant, whole, benchmark))
    model = compile_plant(named)
    test = whole.recording(benchmark.test)
    drawn = [error(replace(model, theta=theta), test, benchmark) for theta in named.sample(DRAWS, SEED)]
    return {
        "unit": benchmark.unit,
        "window": benchmark.window,
        "rows": rows,
        "fitted_to_test": scored("the same structure fitted to the test record", best, whole, benchmark, effects_text(best)),
        "test_of_draws": dict(zip(map(str, PERCENTILES), np.percentile(drawn, PERCENTILES), strict=True)),
        "published": [vars(item) for item in benchmark.published],
        "gap": {name: answer(gap) for name, gap in gaps.items()},
    }


def answer(gap: GapResult) -> dict[str, Any]:
    """What the workflow says, without its evidence."""
    kept = gap.to_json()
    effects = [{key: item[key] for key in ("name", "target", "parameters", "interval95")} for item in kept["effects"]]
    unnamed = [{key: item[key] for key in ("stage", "depends_on", "form")} for item in kept["unnamed"]]
    return {"verdict": kept["verdict"], "effects": effects, "unnamed": unnamed, "carried": [item.text for item in gap.carried]}


def whole_records(benchmark: Benchmark, raw: Path, place: Workspace, progress: Progress) -> Dataset:
    """The dataset of the recipe, but with its identification record uncut."""
    source = ROOT / "datasets" / benchmark.folder
    text = (source / "recipe.toml").read_text("utf-8")
    recipe = Path(str(place.location)) / "public_benchmarks" / f"{benchmark.folder}.toml"
    recipe.write_text(text.replace("[splits]\n", f'[splits]\nfit = ["{benchmark.identification}"]\n', 1), "utf-8")
    return ingest(raw, place.location, machine=source / "machine.toml", recipe=recipe, progress=progress)


def halves(whole: Dataset, benchmark: Benchmark, roles: tuple[Role, Role]) -> Dataset:
    """The identification record as two recordings with these roles; the test record is held out."""
    record, middle = whole.recording(benchmark.identification), len(whole.recording(benchmark.identification)) // 2
    parts = {"first": record.table.iloc[:middle], "second": record.table.iloc[middle:]}
    recordings = []
    for name, table in parts.items():
        begin = table["time"].iloc[0]
        recordings.append(replace(record, name=name, table=table.assign(time=table["time"] - begin).reset_index(drop=True)))
    test = whole.recording(benchmark.test)
    splits: dict[str, Role] = {"first": roles[0], "second": roles[1], test.name: "held_out"}
    return replace(whole, recordings=(*recordings, test), splits=splits)


def comparison(record: Recording, benchmark: Benchmark) -> Callable[[Plant | Model], Array]:
    """Simulated − measured output of a plant behind the window, with a start that is estimated from the window alone."""
    table = record.table.copy()
    table.loc[table.index[benchmark.window :], benchmark.signal] = np.nan
    started, measured = replace(record, table=table), record.values(benchmark.signal)

    def differences(plant: Plant | Model) -> Array:
        return (free_run(plant, started)[benchmark.signal].to_numpy() - measured)[benchmark.window :]

    return differences


def error(plant: Plant | Model, record: Recording, benchmark: Benchmark) -> float:
    """Root mean square of the differences, in the unit of the set."""
    return float(benchmark.scale * np.sqrt(np.mean(comparison(record, benchmark)(plant) ** 2)))


def scored(model: str, plant: Plant, whole: Dataset, benchmark: Benchmark, remark: str = "") -> dict[str, Any]:
    """One row."""
    record, test = whole.recording(benchmark.identification), whole.recording(benchmark.test)
    errors = {"identification": error(plant, record, benchmark), "test": error(plant, test, benchmark)}
    deviation = benchmark.scale * float(np.std(test.values(benchmark.signal)[benchmark.window :]))
    return {"model": model, **errors, "fit_percent": 100.0 * (1.0 - errors["test"] / deviation), "remark": remark}


def fitted(plant: Plant, record: Recording, benchmark: Benchmark) -> Plant:
    """The plant with the values of its effects by least squares of the free run over one record."""
    places = [(k, name) for k, effect in enumerate(plant.effects) for name in effect.parameters]
    start = np.array([plant.effects[k].parameters[name] for k, name in places], dtype=np.float64)

    def changed(ratios: Array) -> Plant:
        values = dict(zip(places, map(float, ratios * start), strict=True))
        found = plant
        for k, effect in enumerate(plant.effects):
            found = found.with_effect(replace(effect, parameters={name: values[k, name] for name in effect.parameters}))
        return found

    differences = comparison(record, benchmark)

    def misfit(ratios: Array) -> Array:
        return differences(changed(ratios))

    steps = np.full(len(start), STEP)
    return changed(least_squares(misfit, np.ones(len(start)), diff_step=steps, x_scale=10.0 * steps).x)


def network_row(plant: Plant, whole: Dataset, benchmark: Benchmark, progress: Progress) -> dict[str, Any]:
    """The row of a residual network that is fitted to the free run."""
    record, (stage, bound, samples, inputs) = whole.recording(benchmark.identification), benchmark.network
    moved = np.gradient(record.values(benchmark.signal)) * record.rate_hz
    values = {name: record.values(name) for name in record.signals} | {f"speed of {benchmark.axis}": moved}
    columns = [values[name] if name in inputs else np.zeros(0) for name in input_names(whole.machine, benchmark.axis)]
    mean = np.array([column.mean() if len(column) else 0.0 for column in columns])
    scale = np.array([1.0 / column.std() if len(column) else 0.0 for column in columns])
    shape = Shape(stage, benchmark.axis, bound, samples / record.rate_hz, mean, scale)
    found = fit_free_run(plant, shape, comparison(record, benchmark), progress)
    changed = (
        f"{benchmark.scale * found.without:.3g} → {benchmark.scale * found.left_out:.3g} {benchmark.unit} on blocks left out"
    )
    title = "the same and a residual network fitted to the free run"
    if not found.accepted:
        return {"model": title, "identification": None, "test": None, "remark": f"refused: {changed}"}
    return scored(title, found.plant, whole, benchmark, changed)


def effects_text(plant: Plant) -> str:
    """Effects with their values, in SI units."""
    return "; ".join(
        f"{effect.name} {', '.join(f'{name} {value:.4g}' for name, value in effect.parameters.items())}"
        for effect in sorted(plant.effects, key=lambda effect: effect.name)
    )


def shown(row: Mapping[str, Any]) -> tuple[str, str]:
    identification, test = ("–" if row[key] is None else f"{row[key]:.3g}" for key in ("identification", "test"))
    return identification, test


def tables(found: Mapping[str, Any]) -> str:
    """The tables of the page."""
    parts = []
    for name, result in found.items():
        parts.append(f"### {name}")
        header = (f"model, RMSE of the simulation in {result['unit']}", "identification", "test", "remark")
        rows = [(row["model"], *shown(row), row["remark"]) for row in [*result["rows"], result["fitted_to_test"]]]
        parts.append(markdown(header, rows, "lrrl"))
        low, middle, high = result["test_of_draws"].values()
        parts.append(
            f"Test error of {DRAWS} plants drawn from the uncertainty of the named values: median {middle:.3g}, 5th to 95th "
            f"percentile {low:.3g} to {high:.3g} {result['unit']}."
        )
        header = ("published", f"test [{result['unit']}]", "source", "remark")
        rows = [(item["model"], f"{item['error']:.3g}", item["source"], item["remark"]) for item in result["published"]]
        parts.append(markdown(header, rows, "lrll"))
    return "\n\n".join(parts)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raw", type=Path, help="folder with emps/ and cascaded_tanks/, each with its files")
    parser.add_argument("--workspace", type=Path, default=Path("workspace"))
    parser.add_argument("--publish", action="store_true", help="write reports/public_benchmarks/")
    given = parser.parse_args()
    made = json.loads(main(given.raw, given.workspace).read_text("utf-8"))
    if given.publish:
        head = provenance("python pipelines/public_benchmarks.py DATA --publish", SEED, ("torch",))
        write_result(FOLDER / "result.json", {**head, **made["benchmarks"]})
        write_tables(FOLDER / "README.md", tables(made["benchmarks"]), "pipelines/public_benchmarks.py")
