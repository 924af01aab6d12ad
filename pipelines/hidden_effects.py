"""Error rates of the gap workflow on sealed cases with known hidden effects.

    .venv/bin/python pipelines/hidden_effects.py --tier smoke|quick|full [--bench own|foreign] [--seed N|commit]
                                                 [--only GROUP] [--workers N] [--limit N] [--answered] [--resume]

Each case is a machine with no, one, two or three hidden effects, or a feature outside the catalogue, recorded with noise,
disturbances and various excitations. The workflow gets logs and description only, in a separate process; the truth is read
for the evaluation afterwards.

The bench is simulated_bench, or ("foreign") 200 machines that MuJoCo and PyBullet simulate, with the result in
reports/hidden_effects/foreign.json.

The cases follow from the seed. By default it is that of the commit (its first eight hex digits): a change of the search changes
the cases, so that it cannot be tuned to them. Such a run needs a tree without changes. A whole tier of it, or with --answered
the cases answered so far, writes result.json and README.md of reports/hidden_effects/. With --seed N the
result stays in the work folder. An interrupted run continues; with --resume, also on another computer, from the result file of
the same seed and tier.

Order of reading of hidden/: seed, machines, kinds, cases, limits, make (files), solve (the workflow), runner, evaluate, score,
page; in foreign/ machines, mjcf, kinds, cases, limits, truth, make.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from committed import provenance, write_result, write_tables
from hidden.bench import BENCHES, PAGE, Bench
from hidden.cases import GROUPS, CaseSpec, Group, Tier, listed
from hidden.evaluate import CaseResult, evaluate
from hidden.page import page_tables
from hidden.runner import ANSWERING, Place, run_all
from hidden.score import scored
from hidden.seed import Seed, check_same_seed, check_unchanged, seed_of

ROOT = Path(__file__).resolve().parents[1]


def evaluated(specs: Sequence[CaseSpec], work: Path, earlier: Mapping[str, CaseResult]) -> list[CaseResult]:
    """Every case that has an answer, and the others that were evaluated earlier."""
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
            found.append(evaluate(json.loads(sealed.read_text("utf-8")), answer, reached))
        elif spec.name in earlier:
            found.append(earlier[spec.name])
    return found


def evaluated_in(result: Path, specs: Sequence[CaseSpec]) -> dict[str, CaseResult]:
    """Evaluated cases of a result file, by name, as far as they are unchanged; empty without a file."""
    if not result.exists():
        return {}
    known = [CaseResult.from_json(each) for each in json.loads(result.read_text("utf-8"))["judgements"]]
    same = {spec.name: spec for spec in specs}
    return {each.spec.name: each for each in known if same.get(each.spec.name) == each.spec}


def _unmade(spec: CaseSpec, answer: dict[str, Any]) -> CaseResult:
    return evaluate({"spec": spec.to_json(), "hidden": [], "effects": []}, answer)


def result_of(
    tier: str, seed: Seed, cases: Sequence[CaseResult], listed: int, command: str, packages: tuple[str, ...] = ()
) -> dict[str, Any]:
    """The contents of the result file."""
    return {
        **provenance(command, seed.value, packages),
        "commit": seed.commit,
        "tier": tier,
        "cases": len(cases),
        "listed": listed,
        **scored(cases),
        "judgements": [case.to_json() for case in cases],
    }


def main(
    bench: Bench,
    tier: Tier,
    seed: Seed,
    work: Path,
    only: Group | None = None,
    workers: int = 1,
    limit: int | None = None,
    keep: bool = False,
    answered: bool = False,
    resume: bool = False,
) -> dict[str, Any]:
    """Run the cases of a tier that have no answer yet, or none of them, and score what there is.

    Args:
        work: cases and answers of each seed lie in a folder of its own in it.
    """
    specs = bench.cases_of(tier, seed.value, only)[:limit]
    if resume:
        check_same_seed(seed, bench.result)
    earlier = evaluated_in(bench.result, specs) if resume else {}
    place = work / f"seed-{seed.value}"
    if not answered:
        waiting = [spec for spec in specs if spec.name not in earlier]
        run_all(waiting, place, workers, keep, lambda text: print(text, flush=True), ANSWERING, bench.make)
    command = f"python {bench.command} --tier {tier}" + ("" if seed.published else f" --seed {seed.value}")
    result = result_of(tier, seed, evaluated(specs, place, earlier), len(specs), command, bench.packages)
    write_result(place / f"result-{tier}.json", result)
    print(page_tables(result))
    if only is None and limit is None and seed.published:
        check_unchanged(seed, ROOT)
        write_result(bench.result, result)
        write_tables(PAGE, page_tables(result), bench.command)
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tier", choices=("smoke", "quick", "full"), default="quick")
    parser.add_argument(
        "--bench", choices=list(BENCHES), default="own", help="whose machines: ours, or other people's simulators"
    )
    parser.add_argument("--seed", default="commit", help="of the cases: a number, or 'commit' (default), whose result is kept")
    parser.add_argument("--only", choices=GROUPS)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--limit", type=int, help="at most so many cases")
    parser.add_argument("--work", type=Path, default=ROOT / "workspace" / "hidden_effects", help="folder of cases and answers")
    parser.add_argument("--keep", action="store_true", help="keep the logs of the cases")
    parser.add_argument("--answered", action="store_true", help="run nothing, score the cases that have an answer")
    parser.add_argument("--resume", action="store_true", help="take over what the result file has evaluated, of the same seed")
    parser.add_argument("--list", action="store_true", help="show the cases and stop")
    given = parser.parse_args()
    try:
        seed, bench = seed_of(given.seed, ROOT), BENCHES[given.bench]
        if given.list:
            print("\n".join(listed(bench.cases_of(given.tier, seed.value, given.only))))
        else:
            work = given.work / given.bench
            main(
                bench, given.tier, seed, work, given.only, given.workers, given.limit, given.keep, given.answered, given.resume
            )
    except ValueError as error:
        parser.exit(2, f"{error}\n")
