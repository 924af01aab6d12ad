"""What feedback, hindsight and the rest are worth: policies trained side by side, followed on one helix.

.venv/bin/python pipelines/training.py [--tier small|full] [--workers N] [--workspace DIR] [--minutes N]

Needs the versions that `make demo` makes. It goes on where it was stopped, elsewhere from what the committed result has.
``full`` takes some four hours of a core; with ``--minutes`` nothing is begun after so many, and what there is then is written.
Its result goes to reports/training/, its tables into docs/ddpg.md, its curves into docs/images/training.svg. ``small`` is a
look at whether everything runs, and stays in the workspace.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from committed import provenance, write_result, write_tables
from sysid.files import json_text, written_whole
from sysid.reports.charts import WIDE, Line, chart
from sysid.rl.seeds import side_by_side
from trained.peer import peer
from trained.policies import baselines, one
from trained.runs import CANDIDATES, CHOICES, DRIVEN, FORWARDS, PAPER, ROOT, SAME, Run, runs, seconds_to

RESULT, PAGE, PICTURE = ROOT / "reports" / "training" / "result.json", ROOT / "docs" / "ddpg.md", "docs/images/training.svg"
#: Share of the episodes and seeds by part.
TIERS: dict[str, tuple[float, dict[str, int]]] = {
    "small": (0.02, {"policies": 1, "driven": 1, "choices": 1, "candidates": 1, "peer": 1}),
    "full": (1.0, {"policies": 5, "driven": 3, "choices": 3, "candidates": 3, "peer": 3}),
}
#: SB3 gets so many times the processor time of a whole quick policy.
PATIENCE = 5.0
#: The policies that are trained before SB3's; the others are trained after them.
FIRST = ("quick", "paper")
STYLE = (
    "<style>text{font:12px sans-serif;fill:#666}.grid,.zero{stroke:#999;stroke-opacity:.35}path{fill:none;stroke-width:2}"
    ".after{stroke:#0a7d78}.before{stroke:#c2491d}.spread{stroke:none;fill-opacity:.2}.spread.after{fill:#0a7d78}"
    ".spread.before{fill:#c2491d}</style>"
)


def main(tier: str, workspace: Path, workers: int | None, minutes: float = math.inf) -> Path:
    """Train what is not there yet and write the result."""
    until = time.time() + 60.0 * minutes
    share, seeds = TIERS[tier]
    work = workspace / "training_study" / tier
    work.mkdir(parents=True, exist_ok=True)
    todo = list(runs(share, seeds))
    if tier == "full":
        put_back(RESULT, todo, work)
    results: dict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)

    def train(those: Sequence[Run]) -> None:
        found = _all(one, [(str(workspace), str(work), run, until) for run in those], workers)
        for run, result in zip(those, found, strict=True):
            if result is not None:
                results[run.part, run.arm].append(result)

    train([run for run in todo if run.part in FIRST])
    if not results["quick", "feedback"]:
        raise SystemExit(f"no policy of quick.toml was done in {minutes:g} minutes; give it more, the next start goes on")
    limit = PATIENCE * statistics.median(result["cpu_seconds"] for result in results["quick", "feedback"])
    peers = _all(peer, [(str(workspace), str(work), seed, limit, until) for seed in range(seeds["peer"])], workers)
    theirs = [each for each in peers if each is not None]
    train([run for run in todo if run.part not in FIRST])
    rows = baselines(str(workspace))
    head = provenance(f"pipelines/training.py --tier {tier}", 0, ("torch", "stable-baselines3"))
    done = [result for each in results.values() for result in each]
    whole = head | {"listed": len(todo), "baselines": rows, "runs": done, "stable_baselines3": theirs}
    text, picture = tables(results, theirs, rows, len(todo)), curves(results)
    if tier == "full":
        write_result(RESULT, whole)
        write_tables(PAGE, text, "pipelines/training.py")
        (ROOT / PICTURE).write_text(picture, "utf-8")
        return RESULT
    (work / "result.json").write_text(json_text(whole), "utf-8")
    (work / "tables.md").write_text(text + "\n", "utf-8")
    (work / "curves.svg").write_text(picture, "utf-8")
    return work / "result.json"


def put_back(result: Path, todo: Sequence[Run], work: Path) -> None:
    """Leave in ``work`` what a committed result has of these runs, so that they are not trained again."""
    if not result.exists():
        return
    known = json.loads(result.read_text("utf-8"))
    names = {json_text(asdict(run)): run.name for run in todo}
    kept = {names[text]: each for each in known["runs"] if (text := json_text(each["run"])) in names}
    kept |= {f"sb3-seed{each['seed']}": each for each in known["stable_baselines3"]}
    for name, each in kept.items():
        done = work / f"{name}.json"
        if not done.exists():
            with written_whole(done) as half:
                half.write_text(json_text(each), "utf-8")


def _all(
    work: Callable[..., dict[str, Any] | None], calls: Sequence[tuple[Any, ...]], workers: int | None
) -> list[dict[str, Any] | None]:
    last = [0.0]

    def tell(share: float, text: str) -> None:
        if share - last[0] >= 0.01:
            last[0] = share
            print(f"{100.0 * share:4.0f} %  {text}", flush=True)

    return side_by_side(work, calls, workers, tell)


def tables(
    results: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]],
    peers: Sequence[Mapping[str, Any]],
    inverse: Mapping[str, Sequence[Mapping[str, Any]]],
    listed: int,
) -> str:
    """Comparison, full path, choices, candidates, peer, as Markdown; ``inverse``: figures of inverse kinematics.

    ``listed`` runs belong to it, of which some may not be done.
    """
    done = sum(map(len, results.values()))
    head = [f"{done} of {listed} policies; the others are not trained yet."] if done < listed else []
    parts = (
        head, _comparison(results, inverse["at once"]), _driven(results, inverse), _choices(results), _candidates(results),
        _peer(results, peers),
    )  # fmt: skip
    return "\n\n".join(text for part in parts if (text := "\n".join(part)))


def _comparison(
    results: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]], inverse: Sequence[Mapping[str, Any]]
) -> Iterator[str]:
    yield "| helix, joints follow at once | seeds | RMSE x/y/z, mm (median; worst) | largest error x/y/z, mm | CPU |"
    yield "| --- | --- | --- | --- | --- |"
    for arm, number in (("feedback", 1), ("plain", 2)):
        worst = "27.2/14.5/26.3" if number == 1 else "–"
        yield f"| the paper's policy {number} ({arm}) | 1 | {_mm(PAPER[arm])} | {worst} | – |"
    for part, what in (("paper", "the paper's recipe, cut to 60 000 updates"), ("quick", "`quick.toml`")):
        for arm in ("feedback", "plain"):
            if each := results.get((part, arm)):
                cpu = statistics.median(result["cpu_seconds"] for result in each)
                yield f"| {what}, {arm} | {len(each)} | {_spread(each, 'rmse')} | {_spread(each, 'max')} | {cpu:.0f} s |"
    searched = results["quick", "feedback"]
    yield f"| `quick.toml`, feedback, candidates at run time too | {len(searched)} | {_spread(searched, 'rmse_searched')} | | |"
    for row in inverse:
        yield f"| inverse kinematics (`{row['policy']}`) | – | {_list(row['rmse_mm'])} | {_list(row['max_mm'])} | – |"
    for part in ("paper", "quick"):
        better = _better(results.get((part, "feedback"), ()), results.get((part, "plain"), ()))
        yield ""
        yield f"Feedback is better than none, by the distance over the helix, in {sum(better)} of {len(better)} seeds ({part})."


def _driven(
    results: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]], inverse: Mapping[str, Sequence[Mapping[str, Any]]]
) -> Iterator[str]:
    yield (
        "| helix, full path, after the first second: RMSE x/y/z, mm | "
        + " | ".join(f"controller {name}" for name in DRIVEN)
        + " |"
    )
    yield "| --- |" + " --- |" * len(DRIVEN)
    plain, ahead = zip(*(inverse[name] for name in DRIVEN), strict=True)
    yield "| inverse kinematics | " + " | ".join(_list(row["settled"]["rmse_mm"]) for row in plain) + " |"
    figures = (f"{_list(row['settled']['rmse_mm'])} ({row['lookahead_s']:.2f} s)" for row in ahead)
    yield "| the same, shown the path as far ahead as suits it best | " + " | ".join(figures) + " |"
    found = [results.get(("driven", name), ()) for name in DRIVEN]
    if any(found):
        yield "| `driven.toml`, seeds | " + " | ".join(str(len(each)) for each in found) + " |"
        for key, how in (("rmse", "trained through the controller below it (median; worst)"), ("rmse_ahead", "{:.2f} s ahead")):
            text = how.format(next(each[0]["ahead_s"] for each in found if each))
            yield f"| {text} | " + " | ".join(_spread(each, key) if each else "–" for each in found) + " |"


def _choices(results: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]]) -> Iterator[str]:
    yield "| `quick.toml` | seeds | RMSE x/y/z, helix, mm (median; worst) | from afar, anywhere, mm | to the paper's accuracy |"
    yield "| --- | --- | --- | --- | --- |"
    for arm in CHOICES:
        if not (each := _arm(results, "choices", arm)):
            continue
        afar = statistics.median(
            1e3 * float(np.linalg.norm([result["evaluations"][-1][f"reach_rmse_{axis}"] for axis in "xyz"])) for result in each
        )
        yield f"| {arm} | {len(each)} | {_spread(each, 'rmse')} | {afar:.1f} | {_until(each)} |"


def _candidates(results: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]]) -> Iterator[str]:
    yield "| the paper's recipe, cut: distance on the helix, mm | " + " | ".join(FORWARDS) + " |"
    yield "| --- |" + " --- |" * len(FORWARDS)
    plain = _away(_arm(results, "candidates", "1"))
    yield f"| 1 candidate (plain) | {plain} |" + " |" * (len(FORWARDS) - 1)
    for count in CANDIDATES:
        away = (_away(_arm(results, "candidates", f"{count} {forward}")) for forward in FORWARDS)
        yield f"| {count} | " + " | ".join(away) + " |"


def _arm(results: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]], part: str, arm: str) -> Sequence[Mapping[str, Any]]:
    """The policies of an arm of an ablation; where the comparison has trained them, those with the seeds of the other arms."""
    if (same := SAME.get((part, arm))) is None:
        return results.get((part, arm), ())
    seeds = {result["run"]["seed"] for (other, _), each in results.items() if other == part for result in each}
    return [result for result in results.get(same, ()) if result["run"]["seed"] in seeds]


def _peer(results: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]], peers: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    ours = [seconds_to(result, PAPER["feedback"]) for result in results["quick", "feedback"]]
    yield f"Processor time to {_mm(PAPER['feedback'])} mm on the helix: `quick.toml` {_times(ours)}; Stable-Baselines3's DDPG"
    if not peers:
        yield "has not been run yet."
        return
    theirs = [seconds_to(result, PAPER["feedback"]) for result in peers]
    reached = "; ".join(
        f"{_mm(min((mark['rmse'] for mark in result['marks']), key=lambda rmse: float(np.linalg.norm(rmse))))} mm at best"
        for result in peers
    )
    yield f"{_times(theirs)}, given {max(result['limit'] for result in peers):.0f} s ({reached})."


def curves(results: Mapping[tuple[str, str], Sequence[Mapping[str, Any]]]) -> str:
    """Reward curves with their spread over the seeds, feedback (green) and plain (orange), of both recipes."""
    parts = []
    for number, (part, title) in enumerate((("paper", "the paper's recipe, cut"), ("quick", "quick.toml"))):
        lines, x = [], np.zeros(1)
        for arm, look in (("feedback", "after"), ("plain", "before")):
            found = [[entry["distance"] for entry in result["episodes"]] for result in results.get((part, arm), ())]
            if not found:
                continue
            table = 1e3 * np.array([row[: min(map(len, found))] for row in found])
            x = np.array([entry["step"] for entry in results[part, arm][0]["episodes"]])[: table.shape[1]] / 1e3
            lines.append(Line(table.mean(axis=0), look, spread=table.std(axis=0) if len(table) > 1 else None))
        drawn = chart(x, lines, ("thousand steps", f"{title}: distance [mm]"), size=WIDE)
        parts.append(
            drawn.replace("<svg ", f'<svg x="{number * WIDE[0]:.0f}" width="{WIDE[0]:.0f}" height="{WIDE[1]:.0f}" ', 1)
        )
    size = f'viewBox="0 0 {2 * WIDE[0]:.0f} {WIDE[1]:.0f}" width="{2 * WIDE[0]:.0f}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{STYLE}{"".join(parts)}</svg>\n'


def _spread(results: Sequence[Mapping[str, Any]], key: str) -> str:
    values = np.array([result[key] for result in results])
    return f"{_mm(np.median(values, axis=0))}; {_mm(values.max(axis=0))}"


def _away(results: Sequence[Mapping[str, Any]]) -> str:
    found = sorted(_distance(result) for result in results)
    return f"{statistics.median(found):.1f} ({found[0]:.1f} to {found[-1]:.1f})" if found else "–"


def _better(feedback: Sequence[Mapping[str, Any]], plain: Sequence[Mapping[str, Any]]) -> list[bool]:
    """For every seed that both have, whether feedback ends nearer to the helix."""
    other = {result["run"]["seed"]: _distance(result) for result in plain}
    return [_distance(result) < other[seed] for result in feedback if (seed := result["run"]["seed"]) in other]


def _distance(result: Mapping[str, Any]) -> float:
    """Root mean square distance from the helix [mm]."""
    return 1e3 * float(np.linalg.norm(result["rmse"]))


def _until(results: Sequence[Mapping[str, Any]]) -> str:
    return _times([seconds_to(result, PAPER["feedback"]) for result in results])


def _times(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    missing = f", not reached by {len(values) - len(known)} of {len(values)}" if len(known) < len(values) else ""
    return (f"{statistics.median(known):.0f} s" if known else "never") + missing


def _mm(values: Sequence[float]) -> str:
    return _list([1e3 * value for value in values])


def _list(values: Sequence[float]) -> str:
    return "/".join(f"{value:.1f}" for value in values)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tier", choices=TIERS, default="small")
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--workspace", type=Path, default=ROOT / "workspace")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin nothing new after so many")
    given = parser.parse_args()
    print(main(given.tier, given.workspace, given.workers, given.minutes))
