"""``sysid train RECIPE``: trains and registers policies."""

from __future__ import annotations

from pathlib import Path

import click

from sysid.cli.output import Printer, cluster_option, json_option, progress_bar
from sysid.errors import SettingsError


@click.command()
@click.argument("recipe", type=click.Path(path_type=Path), metavar="RECIPE.toml")
@click.option("--seed", type=click.IntRange(0), default=None, help="Instead of the recipe's.")
@click.option(
    "--seeds", type=click.IntRange(1), default=None, metavar="N", help="N policies with consecutive seeds, in parallel."
)
@click.option("--workers", type=click.IntRange(1), default=None, help="Processes for --seeds. Default: one per core.")
@cluster_option("For --seeds: address of a Dask scheduler, as tcp://HOST:PORT.")
@click.option("--tensorboard", is_flag=True, help="Event files in WORKSPACE/tensorboard.")
@click.option("--mlflow", metavar="URI", default=None, help="Also log to an MLflow server (or sqlite:///FILE).")
@json_option
@click.pass_obj
def train(
    location: str,
    recipe: Path,
    seed: int | None,
    seeds: int | None,
    workers: int | None,
    cluster: str | None,
    trusted_network: bool,
    tensorboard: bool,
    mlflow: str | None,
    out: Printer,
) -> None:
    """Train a policy that moves the end effector to a target, with the plant and forward model that the recipe names.

    Interrupted training resumes, with bit-identical results, when the same command is repeated. Finished policies are not
    trained again. Learning curves are in WORKSPACE/curves as JSON lines.
    """
    from dataclasses import replace

    from sysid_rl.train.recipe import load_training

    settings = load_training(recipe)
    first = settings.seed if seed is None else seed
    recipes = [replace(settings, seed=number) for number in range(first, first + (seeds or 1))]
    if len(recipes) == 1:
        with progress_bar(f"train {settings.name}") as progress:
            results = [_one(location, recipes[0], tensorboard, mlflow, progress)]
    else:
        from sysid.cores import cores
        from sysid.execution import open_executor

        with progress_bar(f"train {settings.name}, {len(recipes)} seeds") as progress:
            calls = [(location, entry, tensorboard, mlflow) for entry in recipes]
            executor = open_executor(cluster, workers or cores(), trusted_network=trusted_network)
            results = executor.run(_one, calls, progress, reports=True)
    columns = ("policy", "seed", "reaching x/y/z", "staying x/y/z", "worst", "time", "CPU", "updates/s")
    out.table(columns, [_row(result) for result in results], right=(1, 5, 6, 7))
    out.line("The actor alone, root mean square error in mm, from 512 random poses to random targets, then staying there.")
    out.json({"schema": 1, "policies": results})


def _one(location: str, recipe: object, tensorboard: bool, mlflow: str | None, progress: object) -> dict[str, object]:
    from sysid.workspace import open_workspace
    from sysid_rl.train.observers import JsonLines, MlflowRun, Observer, TensorBoard
    from sysid_rl.train.recipe import TrainingRecipe
    from sysid_rl.train.training import train_policy

    assert isinstance(recipe, TrainingRecipe)
    assert callable(progress)
    workspace = open_workspace(location)
    if not workspace.folder.is_dir():
        raise SettingsError(
            f"--workspace {location}", "no such folder", "one with a plant and a forward model", "make demo makes one."
        )
    observers: list[Observer] = [JsonLines(workspace.output(f"curves/{recipe.name}-seed{recipe.seed}.jsonl"))]
    if tensorboard:
        observers.append(TensorBoard(workspace.root.path("tensorboard")))
    if mlflow is not None:
        observers.append(MlflowRun(mlflow))
    done = train_policy(workspace.models, recipe, workspace.root.path("training"), progress, observers)
    return {
        "policy": done.version.reference,
        "seed": recipe.seed,
        "figures": dict(done.figures),
        "seconds": done.seconds,
        "cpu_seconds": done.cpu_seconds,
        "updates_per_second": done.updates_per_second,
    }


def _row(result: dict[str, object]) -> tuple[str, ...]:
    figures, rate = result["figures"], result["updates_per_second"]
    assert isinstance(figures, dict)
    errors = ("/".join(f"{1e3 * figures[f'{phase}_rmse_{axis}']:.1f}" for axis in "xyz") for phase in ("reach", "hold"))
    taken = (
        ("known", "", "")
        if not isinstance(rate, float)
        else (f"{result['seconds']:.0f} s", f"{result['cpu_seconds']:.0f} s", f"{rate:.0f}")
    )
    return (str(result["policy"]), str(result["seed"]), *errors, f"{1e3 * figures['hold_max']:.0f}", *taken)
