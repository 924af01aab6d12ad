"""What each condition of the decision rule changes: sealed cases, decided again with one condition switched off.

    .venv/bin/python pipelines/rule_trials.py [--own N] [--foreign N] [--seed N] [--work DIR] [--workers N] [--report]
        [--publish]
    .venv/bin/python pipelines/rule_trials.py [--search] [--replay] …

A case is searched once and stored with what the rule asks of its sets of effects, so that a further decision takes a fraction
of a second. --search stores cases, --replay decides all that are stored by the rule as it is now and shows which answers differ
from those of the rule with which they were searched: the first thing to do after a change of the rule. A condition that changes
no answer has no reason to be in the rule; one that changes some is argued on its page. Cases are those of hidden_effects.py,
the groups in their proportions, the benches one after the other. An interrupted run continues. With --publish the figures go to
reports/rule_trials/result.json and the table to the page of the rule.

Order of reading of trials/: rules (what is switched off), replaced, memory, stored, cases.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from committed import markdown, provenance, write_result, write_tables
from hidden.bench import BENCHES
from hidden.cases import CaseSpec
from hidden.runner import Place, run_process
from trials.cases import answers_of, changed, decide_case, verdict
from trials.stored import search_case

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "decisions" / "decision-rule.md"
RESULT = ROOT / "reports" / "rule_trials" / "result.json"
#: Longest processor time of a case under all trials [s].
LONGEST = 900.0


def specs_of(bench: str, count: int, seed: int) -> list[CaseSpec]:
    """``count`` cases of a bench, evenly spaced over its full list."""
    listed = BENCHES[bench].cases_of("full", seed, None)
    return [listed[k * len(listed) // count] for k in range(count)]


def searched(bench: str, spec: CaseSpec, work: Path) -> Path | None:
    """The stored search of a case, which is made and searched unless it is done; None where that fails."""
    name = f"{bench}-{spec.name}"
    place, stored, failed = Place(work / bench), work / "searches" / f"{name}.search", None
    if not stored.exists() and not place.sealed(spec).exists():
        failed = run_process(BENCHES[bench].make, [spec, place.work, place.nominal], LONGEST)
    if not stored.exists():
        failed = failed or run_process(search_case, [place.site(spec), place.sealed(spec), stored], LONGEST)
    print(f"{name}{'  ' + failed if failed else ''}", flush=True)
    return None if failed else stored


def decided(stored: Path, out: Path) -> dict[str, Any] | None:
    """The answers of every trial about a stored case; None where that fails."""
    failed = None if out.exists() else run_process(decide_case, [stored, out], LONGEST)
    print(f"{stored.stem}: {failed or 'decided'}", flush=True)
    return None if failed else read(out)


def replay(folder: Path, workers: int) -> str:
    """What the rule as it is now answers about the stored cases, beside the rule with which each was searched."""
    begin, stored = time.monotonic(), sorted((folder / "searches").glob("*.search"))
    with ProcessPoolExecutor(workers, multiprocessing.get_context("forkserver")) as pool:
        pairs = dict(zip([path.stem for path in stored], pool.map(answers_of, stored), strict=True))
    moves = changed({name: {"": first, "now": now} for name, (first, now) in pairs.items()}).get("now", {})
    rows = [
        (name, verdict(first), verdict(now), ", ".join(" ".join(each) for each in now["named"]))
        for name, (first, now) in pairs.items()
        if name in moves.get("cases", ())
    ]
    counts = [Counter(verdict(pair[k]) for pair in pairs.values()) for k in (0, 1)]
    before, after = (", ".join(f"{count} {name}" for name, count in sorted(each.items())) for each in counts)
    head = f"{len(pairs)} stored cases in {time.monotonic() - begin:.0f} s. When searched: {before}; now: {after}."
    return f"{head}\n\n{markdown(('case', 'when searched', 'now', 'names now'), rows, 'llll')}" if rows else head


def read(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(out.read_text("utf-8"))
    return found


def table_of(result: dict[str, Any]) -> str:
    counts = ", ".join(f"{count} {name}" for name, count in result["verdicts"].items())
    rows = [
        (
            trial,
            str(each["changed"]),
            "; ".join(f"{count} {move}" for move, count in each["moves"].items()),
            ", ".join(f"{count} {way}" for way, count in each.get("plants", {}).items() if count),
        )
        for trial, each in sorted(result["trials"].items(), key=lambda item: -item[1]["changed"])
        if each["changed"] or any(each.get("plants", {}).values())
    ]
    silent = ", ".join(trial for trial, each in result["trials"].items() if trial not in {row[0] for row in rows})
    needed = ", ".join(f"{condition} ({count})" for condition, count in result["needed"].items())
    cases = str(result["cases"]) if result["cases"] == result["listed"] else f"{result['cases']} of {result['listed']}"
    groups = ", ".join(f"{name} {count}" for name, count in result["groups"].items())
    head = f"{cases} sealed cases ({groups}), seed {result['seed']}, {result['date']}: {counts}. `{result['command']}`."
    header = "switched off, or changed", "answers that change", "of these", "stages of which the repaired plant leaves a tenth"
    table = markdown(header, rows, "lrll")
    together = f"All others switched off together, these are needed in some case: {needed}."
    return f"{head}\n\n{table}\n\nNo answer and no plant changes without: {silent}.\n\n{together}"


def search(counts: dict[str, int], seed: int, folder: Path, workers: int) -> int:
    """Search and store the cases; returns how many there should be."""
    listed = [(bench, spec) for bench, count in counts.items() for spec in specs_of(bench, count, seed)]
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(lambda item: searched(*item, folder), listed))
    return len(listed)


def main(counts: dict[str, int], seed: int, work: Path, workers: int, publish: bool, report: bool) -> None:
    folder = work / f"seed-{seed}"
    listed = 0 if report else search(counts, seed, folder, workers)
    if report:
        every = {path.stem: read(path) for path in sorted((folder / "answers").glob("*.json"))}
    else:
        stored = sorted((folder / "searches").glob("*.search"))
        outs = [folder / "answers" / f"{path.stem}.json" for path in stored]
        with ThreadPoolExecutor(workers) as pool:
            results = list(pool.map(decided, stored, outs))
        every = {path.stem: result for path, result in zip(stored, results, strict=True) if result}
    found = {name: result["answers"] for name, result in every.items()}
    needed = Counter(condition for result in every.values() for condition in result["needed"])
    verdicts = Counter(verdict(answers[""]) for answers in found.values())
    given = "--report" if report else " ".join(f"--{bench} {count}" for bench, count in counts.items())
    result = {
        **provenance(f"python pipelines/rule_trials.py {given} --seed {seed}", seed),
        "cases": len(found),
        "groups": dict(sorted(Counter(name.rpartition("-")[0].replace("-", " ") for name in found).items())),
        "listed": max(listed, len(found)),
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
    parser.add_argument("--search", action="store_true", help="search and store the cases; no trials")
    parser.add_argument("--replay", action="store_true", help="decide the stored cases by the rule as it is now")
    options = parser.parse_args()
    counts = {"own": options.own, "foreign": options.foreign}
    if options.search or options.replay:
        folder = options.work / f"seed-{options.seed}"
        if options.search:
            search(counts, options.seed, folder, options.workers)
        if options.replay:
            print(replay(folder, options.workers))
        raise SystemExit
    main(counts, options.seed, options.work, options.workers, options.publish, options.report)
