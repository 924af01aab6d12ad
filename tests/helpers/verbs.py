"""The verbs that write to a workspace, on tiny inputs: how each begins, what it does, and what can be seen of it.

What they do is what the command line does, without its parsing. They run in other processes, so they are plain functions here.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

from one_axis_logs import MACHINE, record
from registry_verbs import FILES, PASSED, broken, promote, register, registered, repair
from stored import small_dataset

from sysid.config import parse_settings
from sysid.datasets import Store, append, ingest
from sysid.datasets.versions.manifest import PartRecord
from sysid.errors import StoreError
from sysid.fleet import watching
from sysid.fleet.effects import FleetEffect
from sysid.fleet.result import FleetMachine
from sysid.fleet.watching import WatchState
from sysid.gap.stored_result import load_gap
from sysid.registry import Registry, decide
from sysid.workspace import Workspace

State = tuple[object, ...]


@dataclass(frozen=True)
class Verb:
    """One verb.

    Args:
        prepare: makes the workspace that it starts from.
        work: what it does.
        between: whether it is more than one step for its user, so that others than the first and the last state may be seen.
    """

    name: str
    prepare: Callable[[Path], object]
    work: Callable[[Path], object]
    between: bool = False


def seen(workspace: Path) -> State:
    """All that a user can see of a workspace, each version read to its end."""
    store = Store(workspace)
    datasets = tuple(
        (entry.reference, entry.damage, tuple(r.name for r in store.load(entry.reference).recordings)) for entry in store.list()
    )
    results = tuple(
        (folder.name, result.verdict, len(result.traces), result.machine_diff)
        for folder in sorted((workspace / "results").glob("*"))
        if (result := load_gap(folder / "gap")) is not None
    )
    return datasets, models(Registry(workspace)), results, watched(workspace)


def watched(workspace: Path) -> State:
    """What the states of watched machines hold."""
    found = []
    for path in sorted((workspace / "fleet" / "watch").glob("*.json")):
        state = parse_settings(json.loads(path.read_text("utf-8")), WatchState, str(path))
        found.append((state.machine.dataset, state.recordings, tuple(h.recordings for h in state.histories)))
    return tuple(found)


def models(registry: Registry) -> State:
    """Versions with aliases, decisions and files, each file checked."""
    try:
        return tuple(
            (
                version.reference,
                version.aliases,
                tuple((decision.promoted, decision.instead_of) for decision in version.decisions),
                tuple(sorted(registry.load(version.reference).files)),
            )
            for version in registry.list()
        )
    except StoreError as error:
        return (error.found,)


def logs(folder: Path, *seeds: int) -> None:
    for seed in seeds:
        record(folder / f"r{seed}", seed)
    (folder / "machine.toml").write_text(MACHINE)


def nothing(workspace: Path) -> None:
    logs(workspace.parent / "logs", 0, 1, 2)


def ingested(workspace: Path) -> None:
    nothing(workspace)
    ingest(workspace.parent / "logs", workspace)
    logs(workspace.parent / "more", 3)


def begun(workspace: Path) -> None:
    """A watched machine, and one more recording; what is named on it is given."""
    ingested(workspace)
    effect = FleetEffect("valve_deadband", "a", None, ("positive", "negative"))
    machine = FleetMachine("demo@1", "named", (effect,))
    with mock.patch.object(watching, "name_effects", return_value=machine):
        watching.watch(workspace, "demo")


def several(workspace: Path) -> None:
    store = Store(workspace)
    for seed in (1, 2, 3):
        store.save(*small_dataset(seed), PartRecord(1))


def poses(workspace: Path) -> None:
    from crane_data import dataset
    from crane_data import poses as some_poses

    _, channels = small_dataset(1)
    units = {
        "time": "s",
        **{f"{axis}.joint": "rad" for axis in ("slew", "boom", "stick")},
        **dict.fromkeys(("telescope.joint", "boom.cylinder", "stick.cylinder", "ee.x", "ee.y", "ee.z"), "m"),
    }
    data = replace(dataset((some_poses(count=80),), {}), name="crane", digest="1" * 64, units=units)
    Store(workspace).save(data, channels, PartRecord(1))


def crane(workspace: Path) -> None:
    from crane_store import crane_registry

    crane_registry(workspace)


def ingest_logs(workspace: Path) -> None:
    ingest(workspace.parent / "logs", workspace)


def append_logs(workspace: Path) -> None:
    append(workspace.parent / "more", workspace, "demo")


def watch(workspace: Path) -> None:
    watching.watch(workspace, "demo", [workspace.parent / "more"], quiet_s=0.0)


def vacuum(workspace: Path) -> None:
    Workspace(workspace).vacuum(keep=1)


def fit(workspace: Path) -> None:
    """A forward network with checkpoints at every look, as ``sysid fit forward`` makes it."""
    from sysid.networks import fit_forward, parse_recipe
    from sysid.networks.member import Checkpoints

    place = Workspace(workspace)
    data = place.dataset("crane")
    settings = {"forward": {"hidden": [4], "training": {"epochs": 4, "batch": 16, "check_every": 2}}}
    recipe = parse_recipe(settings, "tiny")
    model = fit_forward(data, recipe, checkpoints=Checkpoints(workspace / "training", every=0.0))
    place.add_network(data, model, recipe)


def add(workspace: Path) -> None:
    """What ``sysid gap --add`` keeps once it has its result: two plants, two decisions, the result."""
    from sample_crane import sample_dataset, sample_gap

    from sysid.gap.promotion import first_promotion

    place, dataset = Workspace(workspace), sample_dataset()
    questioned = place.models.register("autolog", "plant", FILES, {"dataset": dataset.reference})
    repaired = place.models.register("autolog", "plant", FILES, {"dataset": dataset.reference, "gap": "repaired"})
    until_now = first_promotion(place.models, repaired.reference) if questioned else None
    decide(place.models, repaired.reference, until_now, [PASSED], {"by": "sysid gap"})
    result = sample_gap(dataset)
    place.keep_gap(dataset, replace(result, machine_diff="--- machine.toml\n+++ machine.toml\n"))


def train(workspace: Path) -> None:
    """A policy with a checkpoint every few turns, as ``sysid train`` makes it."""
    from training_case import recipe

    from sysid_rl.train import replay
    from sysid_rl.train.training import train_policy

    replay.SEGMENT = 64
    learning = {"episodes": 8, "start": 32, "batch": 16, "buffer": 80}
    train_policy(Registry(workspace), recipe(evaluations=1, learning=learning), workspace / "training", every=0.0)


VERBS = (
    Verb("ingest", nothing, ingest_logs),
    Verb("append", ingested, append_logs),
    Verb("fleet watch", begun, watch, between=True),  # the version first, then the state
    Verb("vacuum", several, vacuum, between=True),  # one version after the other goes
    Verb("register, first of a workspace", lambda workspace: None, register),
    Verb("register", registered, register),
    Verb("promote", registered, promote),
    Verb("repair", broken, repair),
    Verb("fit", poses, fit),
    Verb("gap --add", lambda workspace: None, add, between=True),
    Verb("train", crane, train),
)
