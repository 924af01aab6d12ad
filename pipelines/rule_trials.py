"""What each condition of the decision rule changes: sealed cases, decided again with one condition switched off.

    .venv/bin/python pipelines/rule_trials.py [--own N] [--foreign N] [--seed N] [--work DIR] [--workers N] [--report]
        [--publish]

A case is searched once, and what the rule asks of its sets of effects is remembered, so that a further decision takes a
fraction of a second. A condition that changes no answer has no reason to be in the rule; one that changes some is argued on its
page. The cases are those of hidden_effects.py, the groups in their proportions, the benches one after the other. An interrupted
run continues. With --publish the figures go to reports/rule_trials/result.json and the table to the page of the rule.

Order of reading of trials/: rules (what is switched off), replaced, memory, cases.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from committed import markdown, provenance, write_result, write_tables
from hidden.bench import BENCHES
from hidden.cases import CaseSpec
from hidden.runner import Place, run_process
from trials.cases import changed, decide_case, verdict

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "decisions" / "decision-rule.md"
RESULT = ROOT / "reports" / "rule_trials" / "result.json"
#: Longest processor time of a case under all trials [s].
LONGEST = 900.0


def specs_of(bench: str, count: int, seed: int) -> list[CaseSpec]:
    """``count`` cases of a bench, evenly spaced over its full list."""
    listed = BENCHES[bench].cases_of("full", seed, None)
    return [listed[k * len(listed) // count] for k in range(count)]


def decided(bench: str, spec: CaseSpec, work: Path) -> dict[str, Any] | None:
    """The answers about a case, which is made and decided unless it is done; None where that fails."""
    place, out = Place(work / bench), work / "answers" / f"{bench}-{spec.name}.json"
    if out.exists():
        return read(out)
    failed = None
    if not place.sealed(spec).exists():
        failed = run_process(BENCHES[bench].make, [spec, place.work, place.nominal], LONGEST)
    failed = failed or run_process(decide_case, [place.site(spec), place.sealed(spec), out], LONGEST)
    print(f"{bench} {spec.name}{'  ' + failed if failed else ''}", flush=True)
    return None if failed else read(out)


def read(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(out.read_text("utf-8"))
    return found


def table_of(result: dict[str, Any]) -> str:
    counts = ", ".join(f"{count} {name}" for name, count in result["verdicts"].items())
    rows = [
        (trial, str(each["changed"]), "; ".join(f"{count} {move}" for move, count in each["moves"].items()))
        for trial, each in sorted(result["trials"].items(), key=lambda item: -item[1]["changed"])
        if each["changed"]
    ]
    silent = ", ".join(trial for trial, each in result["trials"].items() if not each["changed"])
    needed = ", ".join(f"{condition} ({count})" for condition, count in result["needed"].items())
    cases = str(result["cases"]) if result["cases"] == result["listed"] else f"{result['cases']} of {result['listed']}"
    groups = ", ".join(f"{name} {count}" for name, count in result["groups"].items())
    head = f"{cases} sealed cases ({groups}), seed {result['seed']}, {result['date']}: {counts}. `{result['command']}`."
    table = markdown(("switched off, or changed", "answers that change", "of these"), rows, "lrl")
    together = f"All others switched off together, these are needed in some case: {needed}."
    return f"{head}\n\n{table}\n\nNo answer changes without: {silent}.\n\n{together}"


def main(counts: dict[str, int], seed: int, work: Path, workers: int, publish: bool, report: bool) -> None:
    folder = work / f"seed-{seed}"
    if report:
        every = {path.stem: read(path) for path in sorted((folder / "answers").glob("*.json"))}
    else:
        listed = [(bench, spec) for bench, count in counts.items() for spec in specs_of(bench, count, seed)]
        with ThreadPoolExecutor(workers) as pool:
            results = list(pool.map(lambda item: decided(*item, folder), listed))
        every = {f"{bench}-{spec.name}": result for (bench, spec), result in zip(listed, results, strict=True) if result}
    found = {name: result["answers"] for name, result in every.items()}
    needed = Counter(condition for result in every.values() for condition in result["needed"])
    verdicts = Counter(verdict(answers[""]) for answers in found.values())
    given = "--report" if report else " ".join(f"--{bench} {count}" for bench, count in counts.items())
    result = {
        **provenance(f"python pipelines/rule_trials.py {given} --seed {seed}", seed),
        "cases": len(found),
        "groups": dict(sorted(Counter(name.rpartition("-")[0].replace("-", " ") for name in found).items())),
        "listed": len(found) if report else len(listed),
        "verdicts": dict(sorted(verdicts.items())),
        "trials": changed(found),
        "needed": dict(needed.most_common()),
    }
    write_result(work / "result.json", result)
    print(table_of(result))
    if publish:
        write_result(RESULT, result)
        write_tables(PAGE, table_of(result), "pipelines/rule_trials.py")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--own", type=int, default=220, help="number of cases of pipelines/simulated_bench")
    parser.add_argument("--foreign", type=int, default=80, help="number of cases of MuJoCo and PyBullet")
    parser.add_argument("--seed", type=int, default=63, help="of the cases")
    parser.add_argument(
        "--work", type=Path, default=ROOT / "workspace" / "rule_trials", help="folder of cases and answers, by seed"
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--publish", action="store_true", help="write the result and the table of the page")
    parser.add_argument("--report", action="store_true", help="of the cases that have answers; no further ones are made")
    options = parser.parse_args()
    counts = {"own": options.own, "foreign": options.foreign}
    main(counts, options.seed, options.work, options.workers, options.publish, options.report)
