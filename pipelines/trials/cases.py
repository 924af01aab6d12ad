"""One sealed case under every trial: searched once, decided by each changed rule."""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from hidden.evaluate import meant
from sysid.datasets import ingest
from sysid.gap import steps
from sysid.gap.proof import ProofOutcome
from sysid.plant import nominal_plant
from trials.memory import Memory
from trials.replaced import load_all, replaced
from trials.rules import CONDITIONS, TRIALS, Changes

Answer = dict[str, Any]


def decide_case(site: Path, sealed: Path, out: Path) -> None:
    """Write the answer of every trial about the logs in ``site``, compared with the truth."""
    load_all()
    truth = json.loads(sealed.read_text("utf-8"))
    hidden = tuple((e["name"], e["target"]) for each in truth["hidden"] for e in each["effects"])
    answers: dict[str, Answer] = {}
    with tempfile.TemporaryDirectory() as workspace, Memory().installed():
        dataset = ingest(site, workspace)
        study = steps.open_study(dataset, nominal_plant(dataset.machine))

        def decided(changes: Changes) -> Answer:
            with replaced(changes):
                return evaluated(steps.decide_on(steps.search(study)), hidden)

        for name, changes in TRIALS.items():
            answers[name] = decided(changes)
        needed = needed_conditions(answers, decided)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps({"hidden": hidden, "answers": answers, "needed": needed}, indent=1) + "\n", "utf-8")


def needed_conditions(answers: Mapping[str, Answer], decided: Callable[[Changes], Answer]) -> list[str]:
    """Conditions without which the answer is worse, where all the others are switched off together.

    One that changes nothing alone may stand for another one like it. They go one after the other, in their order.
    """
    before, off = answers[""], dict[str, Any]()
    spare = [name for name in CONDITIONS if not worse(answers[name], before)]
    together = {where: new for name in spare for where, new in CONDITIONS[name].items()}
    if not worse(decided(together), before):
        return [name for name in CONDITIONS if name not in spare]
    left = []
    for name in spare:
        further = {**off, **CONDITIONS[name]}
        if worse(decided(further), before):
            left.append(name)
        else:
            off = further
    return [name for name in CONDITIONS if name not in spare or name in left]


def worse(answer: Answer, before: Answer) -> bool:
    """Whether an answer has more wrong names or misses more effects."""
    return any(len(answer[key]) > len(before[key]) for key in ("wrong", "missed"))


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


def verdict(answer: Answer) -> str:
    return "wrong" if answer["wrong"] else "incomplete" if answer["missed"] else "exact"


def changed(cases: Mapping[str, Mapping[str, Answer]]) -> dict[str, dict[str, Any]]:
    """Trial → how many answers change, from which verdict to which, and the cases.

    Args:
        cases: by name, the answer of every trial (the same ones in all of them); that of the rule itself has no name.
    """
    table: dict[str, dict[str, Any]] = {}
    for trial in next(iter(cases.values()), {}):
        moves, names = Counter[str](), []
        for name, answers in cases.items():
            before, after = answers[""], answers[trial]
            if [before["named"], before["ties"]] != [after["named"], after["ties"]]:
                moves[f"{verdict(before)} → {verdict(after)}"] += 1
                names.append(name)
        if trial:
            table[trial] = {"changed": len(names), "moves": dict(sorted(moves.items())), "cases": names}
    return table
