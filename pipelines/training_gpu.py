"""The trainer on a GPU beside the CPU and other trainers, and the paper's recipe complete.

python pipelines/training_gpu.py --workspace DIR [--minutes N] [--work DIR] [--publish]

Needs a CUDA build of torch; SBX is compared where it is installed (`pip install sbx-rl 'jax[cuda13]'`). Without ``--publish``
the result is only printed and kept in the work folder; with it, it goes to reports/training_gpu/, tables to reports/training/.
"""

from __future__ import annotations

import argparse
import importlib.util
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import torch

from benchmarks.rows import in_turns
from benchmarks.training import Updates, ours_on, sb3_on, sbx_on, transitions
from committed import markdown, provenance, write_result, write_tables
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant
from sysid.registry import Registry
from sysid_rl.train.ddpg import Trainer
from sysid_rl.train.recipe import TrainingRecipe, load_training
from sysid_rl.train.tracking_task import TruncatedObservationPolicy, plan_tracking
from sysid_rl.train.training import environments, policy_of
from sysid_rl.train.versions import load_versions
from trained.page import mm

ROOT = Path(__file__).resolve().parents[1]
RECIPES, REPORT, PAGE = ROOT / "rl" / "autolog", ROOT / "reports" / "training_gpu", ROOT / "reports" / "training" / "README.md"
#: Batch, hidden layers, updates of one measurement.
CASES = ((1024, (400, 300), 200), (256, (256, 256), 400), (4096, (512, 512), 50))
REPEATS = 5
#: Updates of a training whose whole steps are timed, environment and exploration included.
TIMED_UPDATES = 3000


def updates_per_second() -> list[dict[str, Any]]:
    """Of every case and trainer: median and extremes of :data:`REPEATS` measurements, taken in turns."""
    torch.set_num_threads(1)
    found = []
    for batch, hidden, updates in CASES:
        rows, works = transitions(), {}
        works["ours, CPU, one thread"] = ours_on("cpu", batch, hidden, rows)
        works["Stable-Baselines3, CPU, one thread"] = sb3_on("cpu", batch, hidden, rows)
        if torch.cuda.is_available():
            works["ours, GPU"] = ours_on("cuda", batch, hidden, rows)
            works["ours, GPU, without a graph"] = ours_on("cuda", batch, hidden, rows, graph=False)
            works["Stable-Baselines3, GPU"] = sb3_on("cuda", batch, hidden, rows)
        if importlib.util.find_spec("sbx"):
            works[f"SBX, {_jax_device()}"] = sbx_on(batch, hidden, rows)
        found += _timed(batch, hidden, updates, works)
    return found


def _timed(batch: int, hidden: tuple[int, ...], updates: int, works: dict[str, Updates]) -> list[dict[str, Any]]:
    counts = {name: max(4, updates // 10) if "CPU" in name else updates for name in works}
    taken = in_turns({name: lambda work=work, n=counts[name]: work(n) for name, work in works.items()}, REPEATS)  # type: ignore[misc]
    return [
        {
            "batch": batch,
            "layers": list(hidden),
            "trainer": name,
            "updates_per_second": [counts[name] / t for t in (statistics.median(times), max(times), min(times))],
        }
        for name, times in taken.items()
    ]


def _jax_device() -> str:
    import jax

    return {"gpu": "GPU", "cpu": "CPU, all cores"}.get(jax.default_backend(), jax.default_backend())


def whole_steps(recipe: TrainingRecipe, plant: Plant, forward: ForwardModel, device: str) -> dict[str, Any]:
    """Seconds of a whole training on a device, from a part of it that has :data:`TIMED_UPDATES` updates."""
    trainer = Trainer(*environments(recipe, plant, forward), replace(recipe, device=device))
    timed, begin, first = TIMED_UPDATES if device == "cuda" else TIMED_UPDATES // 10, 0.0, 0
    for step in trainer.train():
        if begin == 0.0 and trainer.agent.updates >= 10:
            begin, first = time.perf_counter(), step
        if trainer.agent.updates >= timed:
            break
    if device == "cuda":
        torch.cuda.synchronize()
    each = (time.perf_counter() - begin) / (step - first)
    return {"recipe": recipe.name, "device": device, "ms_per_step": 1e3 * each, "estimated_s": each * recipe.total_steps}


def complete(recipe: TrainingRecipe, plant: Plant, forward: ForwardModel, minutes: float) -> dict[str, Any]:
    """A training on the GPU, to its end or until the time is over: error of the actor on the helix at each evaluation."""
    recipe = replace(recipe, device="cuda")
    trainer, task = Trainer(*environments(recipe, plant, forward), recipe), plan_tracking(plant, forward, "helix")
    marks: list[dict[str, Any]] = []
    begin = time.perf_counter()

    def take(kind: str, step: int, figures: object) -> None:
        if kind == "evaluation":
            tracked = task.run("actor", TruncatedObservationPolicy(policy_of(trainer)))
            mark = {"step": step, "seconds": time.perf_counter() - begin, "rmse": tracked.rmse.tolist()}
            marks.append({**mark, "max": tracked.worst.tolist()})
            print(f"{recipe.name}: step {step}, {mark['seconds']:.0f} s, RMSE {[round(1e3 * v, 1) for v in mark['rmse']]} mm")

    for _ in trainer.train(take):
        if time.perf_counter() - begin > 60.0 * minutes:
            take("evaluation", trainer.step_count * trainer.environment.size, {})
            break
    return {
        "recipe": recipe.name,
        "seed": recipe.seed,
        "total_steps": recipe.total_steps,
        "updates": trainer.agent.updates,
        "marks": marks,
    }


def measure(plant: Plant, forward: ForwardModel, minutes: float) -> dict[str, Any]:
    """The whole result."""
    result = provenance("python pipelines/training_gpu.py", 0, ("torch", "stable-baselines3", "sbx-rl", "jax"))
    cuda = torch.cuda.is_available()
    result["gpu"] = torch.cuda.get_device_name() if cuda else None
    result["updates"] = updates_per_second()
    recipes = [load_training(RECIPES / f"{name}.toml") for name in ("feedback", "quick")]
    devices = ("cpu", "cuda") if cuda else ("cpu",)
    result["trainings"] = [whole_steps(recipe, plant, forward, device) for recipe in recipes for device in devices]
    result["complete"] = [complete(recipes[0], plant, forward, minutes)] if cuda and minutes > 0 else []
    return result


def tables(result: dict[str, Any]) -> str:
    """The result for the page."""
    return "\n\n".join([_updates(result["updates"]), _trainings(result["trainings"]), *map(_course, result["complete"])])


def _updates(rows: list[dict[str, Any]]) -> str:
    names = list(dict.fromkeys(row["trainer"] for row in rows))
    cases: dict[str, dict[str, str]] = {}
    for row in rows:
        case = cases.setdefault(f"{row['batch']}, {'-'.join(map(str, row['layers']))}", {})
        case[row["trainer"]] = "{:.0f} ({:.0f} to {:.0f})".format(*row["updates_per_second"])
    return markdown(
        ("batch, layers", *names), [(case, *(cells.get(name, "–") for name in names)) for case, cells in cases.items()]
    )


def _trainings(rows: list[dict[str, Any]]) -> str:
    head = ("recipe", "device", "a step of all copies and its updates, ms", "whole training, estimated, s")
    device = {"cuda": "GPU", "cpu": "CPU, one thread"}
    cells = [(r["recipe"], device[r["device"]], f"{r['ms_per_step']:.2f}", f"{r['estimated_s']:.0f}") for r in rows]
    return markdown(head, cells, "ll")


def _course(run: dict[str, Any]) -> str:
    """Some of the evaluations of a training, and the last."""
    marks, total = run["marks"], run["total_steps"]
    shown = [*marks[: -1 : max(1, len(marks) // 6)], marks[-1]]
    head = ("steps", "time, s", "RMSE x/y/z, mm", "largest error x/y/z, mm")
    cells = [(str(m["step"]), f"{m['seconds']:.0f}", mm(m["rmse"]), mm(m["max"])) for m in shown]
    text = (
        f"`{run['recipe']}` on the GPU, seed {run['seed']}, error of the actor on the helix:\n\n{markdown(head, cells, 'rrll')}"
    )
    if marks[-1]["step"] < total:
        text += f"\n\nStopped after {100 * marks[-1]['step'] / total:.0f} % of its {total} steps."
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workspace", type=Path, default=ROOT / "workspace", help="that of `make demo`")
    parser.add_argument("--minutes", type=float, default=15.0, help="longest duration of the complete training; 0: none")
    parser.add_argument("--publish", action="store_true")
    options = parser.parse_args()
    recipe = load_training(RECIPES / "feedback.toml")
    result = measure(*load_versions(Registry(options.workspace), recipe.plant, recipe.forward), options.minutes)
    print(tables(result))
    if options.publish:
        write_result(REPORT / "result.json", result)
        write_tables(PAGE, tables(result), "pipelines/training_gpu.py")


if __name__ == "__main__":
    main()
