"""Tables and curves of pipelines/training.py, from the results of its runs by part and arm."""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from log_picture import COLOURS, Curve, Panel, picture
from trained.runs import CANDIDATES, CHOICES, DRIVEN, EVERY, FORWARDS, PAPER, SAME, seconds_to

Array = npt.NDArray[np.float64]
#: What runs left, by part and arm.
Results = Mapping[tuple[str, str], Sequence[Mapping[str, Any]]]

#: Colours of the curves.
COLOUR = dict(zip(("feedback", "plain"), COLOURS, strict=False))


def tables(result: Mapping[str, Any]) -> str:
    """Comparison, full path, choices, candidates and peer of the study's result, of which some runs may be missing."""
    results, inverse = by_arm(result["runs"]), result["baselines"]
    done, listed = len(result["runs"]), result["listed"]
    head = [f"{done} of {listed} policies; the others are not trained yet."] if done < listed else []
    parts = (
        head, _comparison(results, inverse["at once"]), _driven(results, inverse), _choices(results), _candidates(results),
        _peer(results, result["stable_baselines3"]),
    )  # fmt: skip
    return "\n\n".join(text for part in parts if (text := "\n".join(part)))


def _comparison(results: Results, inverse: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield "| helix, joints follow at once | seeds | RMSE x/y/z, mm (median; worst) | largest error x/y/z, mm | CPU |"
    yield "| --- | --- | --- | --- | --- |"
    for arm, number in (("feedback", 1), ("plain", 2)):
        worst = "27.2/14.5/26.3" if number == 1 else "–"
        yield f"| the paper's policy {number} ({arm}) | 1 | {mm(PAPER[arm])} | {worst} | – |"
    whole = f"the paper's recipe, one update every {EVERY} steps"
    for part, what in (("whole", whole), ("paper", "the paper's recipe, cut to 60 000 updates"), ("quick", "`quick.toml`")):
        for arm in ("feedback", "plain"):
            if each := results.get((part, arm)):
                cpu = statistics.median(result["cpu_seconds"] for result in each)
                yield f"| {what}, {arm} | {len(each)} | {_spread(each, 'rmse')} | {_spread(each, 'max')} | {cpu:.0f} s |"
    searched = results["quick", "feedback"]
    yield f"| `quick.toml`, feedback, candidates at run time too | {len(searched)} | {_spread(searched, 'rmse_searched')} | | |"
    farthest = 1e3 * max(result["evaluations"][-1]["reach_max"] for result in searched)
    anywhere = "`quick.toml`, feedback, from any pose to any target in one step"
    yield f"| {anywhere} | {len(searched)} | {_middle(_afar(searched))} | {farthest:.0f} away | |"
    for row in inverse:
        yield f"| inverse kinematics (`{row['policy']}`) | – | {_list(row['rmse_mm'])} | {_list(row['max_mm'])} | – |"
    for part in ("paper", "quick"):
        better = _better(results.get((part, "feedback"), ()), results.get((part, "plain"), ()))
        yield ""
        yield f"Feedback is better than none, by the distance over the helix, in {sum(better)} of {len(better)} seeds ({part})."


def _driven(results: Results, inverse: Mapping[str, Sequence[Mapping[str, Any]]]) -> Iterator[str]:
    head = "helix, full path, after the first second: RMSE x/y/z, mm"
    yield f"| {head} | " + " | ".join(f"controller {name}" for name in DRIVEN) + " |"
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


def _choices(results: Results) -> Iterator[str]:
    yield "| `quick.toml` | seeds | RMSE x/y/z, helix, mm (median; worst) | reaching, anywhere, mm | to the paper's accuracy |"
    yield "| --- | --- | --- | --- | --- |"
    for arm in CHOICES:
        if not (each := _arm(results, "choices", arm)):
            continue
        afar = 1e3 * float(np.median(np.linalg.norm(_afar(each), axis=1)))
        yield f"| {arm} | {len(each)} | {_spread(each, 'rmse')} | {afar:.1f} | {_until(each)} |"


def _candidates(results: Results) -> Iterator[str]:
    yield "| the paper's recipe, cut: distance on the helix, mm | " + " | ".join(FORWARDS) + " |"
    yield "| --- |" + " --- |" * len(FORWARDS)
    plain = _away(_arm(results, "candidates", "1"))
    yield f"| 1 candidate (plain) | {plain} |" + " |" * (len(FORWARDS) - 1)
    for count in CANDIDATES:
        away = (_away(_arm(results, "candidates", f"{count} {forward}")) for forward in FORWARDS)
        yield f"| {count} | " + " | ".join(away) + " |"


def by_arm(runs: Iterable[Mapping[str, Any]]) -> Results:
    """Results of ``runs`` by part and arm; an arm without runs is empty."""
    found: dict[tuple[str, str], list[Mapping[str, Any]]] = defaultdict(list)
    for each in runs:
        found[each["run"]["part"], each["run"]["arm"]].append(each)
    return found


def _arm(results: Results, part: str, arm: str) -> Sequence[Mapping[str, Any]]:
    """The policies of an arm of an ablation; where the comparison has trained them, those with the seeds of the other arms."""
    if (same := SAME.get((part, arm))) is None:
        return results.get((part, arm), ())
    seeds = {result["run"]["seed"] for (other, _), each in results.items() if other == part for result in each}
    return [result for result in results.get(same, ()) if result["run"]["seed"] in seeds]


def _peer(results: Results, peers: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    ours = [seconds_to(result, PAPER["feedback"]) for result in results["quick", "feedback"]]
    yield f"Processor time to {mm(PAPER['feedback'])} mm on the helix: `quick.toml` {_times(ours)}; Stable-Baselines3's DDPG"
    if not peers:
        yield "has not been run yet."
        return
    theirs = [seconds_to(result, PAPER["feedback"]) for result in peers]
    reached = "; ".join(f"{mm(min(result['marks'], key=_distance)['rmse'])} mm at best" for result in peers)
    yield f"{_times(theirs)}, given {max(result['limit'] for result in peers):.0f} s ({reached})."


def curves(result: Mapping[str, Any]) -> str:
    """How both recipes learn: the distance while exploring, which is the reward, and that of the actor alone on the helix."""
    results = by_arm(result["runs"])
    level = {"the paper's policy 1": 1e3 * float(np.linalg.norm(PAPER["feedback"]))}
    panels = []
    for part, title in (("paper", "the paper's recipe, cut"), ("quick", "quick.toml")):
        exploring, alone = [], []
        for arm, colour in COLOUR.items():
            if each := results.get((part, arm)):
                exploring.append(_curve(arm, colour, each, "episodes", lambda entry: 1e3 * entry["distance"]))
                alone.append(_curve(arm, colour, each, "marks", _distance))
        if exploring:
            panels.append(Panel(f"{title}: distance while exploring [mm]", exploring, _steps(exploring)))
            panels.append(Panel(f"{title}: actor alone on the helix, RMS [mm]", alone, _steps(alone), level))
    return picture(panels)


def _curve(
    label: str, colour: str, results: Sequence[Mapping[str, Any]], key: str, value: Callable[[Mapping[str, Any]], float]
) -> Curve:
    """Median of the seeds over their steps, and how far they lie apart."""
    steps = [entry["step"] for entry in results[0][key]]
    found = np.sort([[value(entry) for entry in result[key]] for result in results], axis=0)
    return Curve(label, colour, steps, np.median(found, axis=0).tolist(), band=list(zip(found[0], found[-1], strict=True)))


def _steps(curves: Sequence[Curve]) -> dict[float, str]:
    """Ticks: first and last step, and the powers of ten between them."""
    first, last = curves[0].x[0], curves[0].x[-1]
    powers = [10.0**k for k in range(math.ceil(math.log10(1.5 * first)), math.floor(math.log10(last / 1.5)) + 1)]
    return {step: f"{step / 1e3:,.3g}k" for step in (first, *powers, last)}


def _afar(results: Sequence[Mapping[str, Any]]) -> Array:
    """Root mean square error from any pose to any target in one step, (n, 3) [m]."""
    return np.array([[result["evaluations"][-1][f"reach_rmse_{axis}"] for axis in "xyz"] for result in results])


def _spread(results: Sequence[Mapping[str, Any]], key: str) -> str:
    return _middle(np.array([result[key] for result in results]))


def _middle(values: Array) -> str:
    """Median and worst of the seeds, (n, 3) [m]."""
    return f"{mm(np.median(values, axis=0))}; {mm(values.max(axis=0))}"


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
    if not known:
        return f"never by any of {len(values)}"
    missing = f", not reached by {len(values) - len(known)} of {len(values)}" if len(known) < len(values) else ""
    return f"{statistics.median(known):.0f} s{missing}"


def mm(values: Sequence[float]) -> str:
    return _list([1e3 * value for value in values])


def _list(values: Sequence[float]) -> str:
    return "/".join(f"{value:.1f}" for value in values)
