"""How often the gap workflow is right: sealed cases of the stand-in machine, answered blind, then judged.

    .venv/bin/python pipelines/hidden_effects.py --tier smoke|quick|full [--only GROUP] [--workers N] [--limit N]
                                                 [--answered] [--resume]

Each case is a machine that hides no, one, two or three effects, or something that the catalogue does not know, recorded with
noise, disturbances and more or less excitation. The workflow sees logs and description alone, in a process of its own; the
truth is opened when all have answered. A run that was stopped goes on where it was; with --resume, on another machine
too, from what reports/hidden_effects/result.json has of the tier. A whole tier, or with --answered what there is of it, writes
that file and the tables of docs/hidden-effects.md.

Order of reading of hidden/: machines, kinds, cases (what is tried), limits, make (files), solve (the run, which sees the site's
files alone), runner, judge, score, page.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from committed import provenance, write_result, write_tables
from hidden.cases import COUNTS, GROUPS, SEED, CaseSpec, Group, Tier, cases_of, listed
from hidden.judge import Judgement, judge
from hidden.page import page_tables
from hidden.runner import ANSWERING, Place, run_all
from hidden.score import scored

ROOT = Path(__file__).resolve().parents[1]
RESULT = ROOT / "reports" / "hidden_effects" / "result.json"
PAGE = ROOT / "docs" / "hidden-effects.md"


def judged(specs: Sequence[CaseSpec], work: Path, earlier: Mapping[str, Judgement]) -> list[Judgement]:
    """Every case that has an answer, and the others that were judged earlier."""
    place = Place(work)
    found = []
    for spec in specs:
        if place.answer(spec).exists():
            answer = json.loads(place.answer(spec).read_text("utf-8"))
            sealed = place.sealed(spec)
            if not sealed.exists():
                if "failure" not in answer:
                    raise FileNotFoundError(f"{spec.name} has an answer, but no truth to compare it with: {sealed}")
                found.append(_unmade(spec, answer))
                continue
            reach = place.reach(spec)
            reached = json.loads(reach.read_text("utf-8")) if reach.exists() else None
            found.append(judge(json.loads(sealed.read_text("utf-8")), answer, reached))
        elif spec.name in earlier:
            found.append(earlier[spec.name])
    return found


def judged_in(result: Path, specs: Sequence[CaseSpec]) -> dict[str, Judgement]:
    """By name, what a result file says of cases that are still the same; nothing where there is no file."""
    if not result.exists():
        return {}
    known = [Judgement.from_json(each) for each in json.loads(result.read_text("utf-8"))["judgements"]]
    same = {spec.name: spec for spec in specs}
    return {each.spec.name: each for each in known if same.get(each.spec.name) == each.spec}


def _unmade(spec: CaseSpec, answer: dict[str, Any]) -> Judgement:
    return judge({"spec": spec.to_json(), "hidden": [], "effects": []}, answer)


def result_of(tier: str, cases: Sequence[Judgement], listed: int, command: str) -> dict[str, Any]:
    """The contents of the result file."""
    return {
        **provenance(command, SEED),
        "tier": tier,
        "cases": len(cases),
        "listed": listed,
        **scored(cases),
        "judgements": [case.to_json() for case in cases],
    }


def main(
    tier: Tier,
    work: Path,
    only: Group | None = None,
    workers: int = 1,
    limit: int | None = None,
    keep: bool = False,
    answered: bool = False,
    resume: bool = False,
) -> dict[str, Any]:
    """Run the cases of a tier that have no answer yet, or none of them, and score what there is."""
    specs = cases_of(tier, only)[:limit]
    earlier = judged_in(RESULT, specs) if resume else {}
    if not answered:
        waiting = [spec for spec in specs if spec.name not in earlier]
        run_all(waiting, work, workers, keep, lambda text: print(text, flush=True), ANSWERING)
    command = f"python pipelines/hidden_effects.py --tier {tier}"
    result = result_of(tier, judged(specs, work, earlier), len(specs), command)
    write_result(work / f"result-{tier}.json", result)
    print(page_tables(result))
    if only is None and limit is None:
        write_result(RESULT, result)
        write_tables(PAGE, page_tables(result), "pipelines/hidden_effects.py")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tier", choices=list(COUNTS), default="quick")
    parser.add_argument("--only", choices=GROUPS)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--limit", type=int, help="at most so many cases")
    parser.add_argument("--work", type=Path, default=ROOT / "workspace" / "hidden_effects", help="folder of cases and answers")
    parser.add_argument("--keep", action="store_true", help="keep the logs of the cases")
    parser.add_argument("--answered", action="store_true", help="run nothing, score the cases that have an answer")
    parser.add_argument("--resume", action="store_true", help="take over what the committed result has judged")
    parser.add_argument("--list", action="store_true", help="show the cases and stop")
    given = parser.parse_args()
    if given.list:
        print("\n".join(listed(given.tier)))
    else:
        main(given.tier, given.work, given.only, given.workers, given.limit, given.keep, given.answered, given.resume)
