"""Processor time of a registry of 300 versions: to list, find, add and promote one."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.rows import against_limit
from sysid.networks.recipe import NetworkRecipe
from sysid.registry import Check, ModelVersion, Registry, decide

VERSIONS = 300
NAME = "crane-forward"
#: Each of the four, in processor time [ms].
LIMIT_MS = 100.0
REPEATS = 7
FILES = {"network.json": b"{}", "weights.safetensors": bytes(200_000)}


def registry_rows() -> list[dict[str, Any]]:
    """One model of :data:`VERSIONS` versions, with the recipe and the figures that ``sysid fit`` records."""
    with tempfile.TemporaryDirectory() as work:
        registry = Registry(Path(work))
        for number in range(VERSIONS):
            add(registry, number)
        numbers = iter(range(VERSIONS, 2 * VERSIONS))
        works: dict[str, Callable[[], object]] = {
            "registry_list": registry.list,
            "registry_resolve": lambda: registry.find(NAME),
            "registry_promote": lambda: promote(registry, next(numbers)),
            "registry_register": lambda: add(registry, next(numbers)),
        }
        note = f"{VERSIONS} versions of one model; processor time of one call, without imports"
        return [against_limit(name, taken(work), LIMIT_MS, "ms", note) for name, work in works.items()]


def add(registry: Registry, number: int) -> ModelVersion:
    lineage = {"dataset": "crane@1", "dataset_digest": "ab" * 32, "recipe": NetworkRecipe().to_json(), "seed": number}
    return registry.register(NAME, "forward", FILES, lineage, {f"rmse ee.{k}": 1e-3 * number for k in range(12)})


def promote(registry: Registry, number: int) -> None:
    """Another version each time, of those that were there at the beginning."""
    check = Check("rmse", "passed", f"ee: rmse {number} µm")
    decide(registry, f"{NAME}@{1 + number % VERSIONS}", registry.promoted(NAME), [check])


def taken(work: Callable[[], object]) -> list[float]:
    """Processor times [ms], after a warm-up call."""
    work()
    times = []
    for _ in range(REPEATS):
        begin = time.process_time()
        work()
        times.append(1e3 * (time.process_time() - begin))
    return times
