"""A searched case on disk: later decisions need no fit that an earlier one has made.

The files are pickles for this folder alone, read by the pipeline that wrote them.
"""

from __future__ import annotations

import copyreg
import json
import os
import pickle
import tempfile
import threading
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cloudpickle  # type: ignore[import-untyped]

from hidden.evaluate import meant
from sysid.datasets import ingest
from sysid.gap import steps
from sysid.gap.held_out import relative_error
from sysid.gap.likelihood.rows import KnownResiduals
from sysid.gap.likelihood.stage import StageLikelihood
from sysid.gap.proof import ProofOutcome
from sysid.plant import nominal_plant
from trials.memory import Memory
from trials.replaced import load_all, replaced
from trials.rules import Changes

Answer = dict[str, Any]


@dataclass(frozen=True)
class StoredCase:
    """A case with what its decisions have asked.

    Args:
        hidden: name and target of the effects in its logs.
        first: the answer of the rule with which it was searched.
    """

    study: steps.Study
    memory: Memory
    hidden: tuple[tuple[str, str], ...]
    first: Answer = field(default_factory=dict)

    def answer(self, changes: Changes) -> Answer:
        """The answer of the rule with ``changes``, compared with the truth."""
        with self.memory.installed(), replaced(changes):
            searched = steps.search(self.study)
            outcome = steps.decide_on(searched)
        return {**evaluated(outcome, self.hidden), "left": left_of(searched, outcome)}

    def write(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        with part.open("wb") as file:
            _Pickler(file, protocol=pickle.HIGHEST_PROTOCOL).dump(self)
        os.replace(part, path)


def stored_case(path: Path) -> StoredCase:
    """A case that :meth:`StoredCase.write` wrote."""
    load_all()
    with path.open("rb") as file:
        found = pickle.load(file)  # noqa: S301 - written by this pipeline
    assert isinstance(found, StoredCase)
    return found


def search_case(site: Path, sealed: Path, out: Path) -> None:
    """Search the logs in ``site`` and decide on them once; ``sealed``: the truth about them."""
    load_all()
    truth = json.loads(sealed.read_text("utf-8"))
    hidden = tuple((e["name"], e["target"]) for each in truth["hidden"] for e in each["effects"])
    with tempfile.TemporaryDirectory() as workspace:
        dataset = ingest(site, workspace)
        case = StoredCase(steps.open_study(dataset, nominal_plant(dataset.machine)), Memory(), hidden)
        first = case.answer({})
    replace(case, first=first).write(out)


def left_of(study: steps.Study, outcome: ProofOutcome) -> dict[str, float]:
    """What the repaired plant leaves of the held-out recordings of each stage, in noise floors."""
    theta = outcome.repaired.vector()
    return {stage.label: relative_error(stage, theta, stage.split.held_out) for stage in study.stages}


def evaluated(outcome: ProofOutcome, hidden: Sequence[tuple[str, str]]) -> Answer:
    """Names and ties of an answer, those that are wrong, and hidden effects that it misses."""
    found = {}
    for effect in outcome.named:
        aliases = [{"name": name, "target": target} for name, target in effect.aliases]
        named = {"name": effect.name, "target": effect.target, "aliases": aliases}
        found[effect.name, effect.target] = meant(named, tuple(hidden))
    return {
        "named": sorted(found),
        "ties": sorted(sorted(tie) for tie in outcome.ties),
        "wrong": sorted(name for name, own in found.items() if own is None),
        "missed": [name for name in hidden if name not in found.values()],
    }


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]
    """Without what belongs to a process (locks, weak references) and what a new fit computes again from the rest."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, StageLikelihood):
            kept = {key: part for key, part in vars(obj).items() if not hasattr(StageLikelihood, key)}
            return copyreg.__newobj__, (StageLikelihood,), kept  # type: ignore[attr-defined]
        if isinstance(obj, type(threading.Lock())):
            return threading.Lock, ()
        if isinstance(obj, weakref.ref):
            return _forgotten, ()
        if isinstance(obj, KnownResiduals):
            return KnownResiduals, ()
        return super().reducer_override(obj)


def _forgotten() -> Any:
    return _nothing


def _nothing() -> None:
    """A reference to what is gone."""
