"""The proof: what was found at each stage is judged once, on recordings that nothing has touched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.gap.candidates import Candidate
from sysid.gap.case import Case, Stage
from sysid.gap.data import Data
from sysid.gap.finding import Finding, Kept
from sysid.gap.fit import Fit, fit_candidates
from sysid.gap.floor import problem_floor
from sysid.gap.intervals import known_of
from sysid.gap.localise import stage_rmse
from sysid.gap.readings import Coarse
from sysid.gap.result import Alternative, Evidence, Gap, NamedEffect, ResidualModelResult, Unnamed, Value
from sysid.gap.unnamed.residual_formula import describe_residual
from sysid.plant import Place, Plant, Uncertainty

Array = npt.NDArray[np.float64]

#: What was found has to bring the held-out error of its stage below this multiple of what it was.
BETTER = 0.98
#: Steps of a sensor matter where its stage is this far above the noise that the sensor is said to have.
SHOWS = 1.15
#: They are its explanation where they account for at least this share of what is above.
MOST = 0.5
#: Without an effect that gets a name the held-out error of its stage has to grow by this factor.
MATTERS = 1.05
#: Where the recordings to select on miss it by more than this factor, the held-out ones, which may move otherwise, need not.
CLEARLY = 1.5
#: Another value of an effect that the plant has already gets a name where it is so many half intervals away, or missed clearly.
CLEAR = 2.0
#: A stage that stays above this multiple of its noise floor has structure that nothing explains.
UNEXPLAINED = 1.5
#: Where errors add up over a run and it stays above this one, how clear something looked on other recordings says little.
STRANGE = 3.0


@dataclass
class Outcome:
    """What the stages together come to."""

    repaired: Plant
    named: list[NamedEffect] = field(default_factory=list)
    ties: list[tuple[tuple[str, str], ...]] = field(default_factory=list)
    unnamed: list[Unnamed] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    carried: list[ResidualModelResult] = field(default_factory=list)


def judge(case: Case, stages: Sequence[Stage]) -> Outcome:
    """Put what was found and proven into the plant, and say of the rest what it is."""
    outcome = Outcome(case.plant)
    for coarse in case.coarse:
        _read_off(case, stages, coarse, outcome)
    for found in stages:
        stage = _that_matter(found, outcome)
        finding = stage.found
        proven = not finding.fit.candidates or held_out_score(stage, finding.fit.theta) < BETTER * held_out_score(
            stage, stage.theta
        )
        if proven:
            _accept(case, stage, outcome)
        elif finding.named:
            outcome.notes.append(f"{stage.label}: what was found did not help on held-out recordings")
        if (finding.final_rmse if proven else finding.nominal_rmse) > UNEXPLAINED:
            fit = finding.fit if proven else Fit((), (), np.empty(0), stage.theta, (), 0.0, True)
            outcome.unnamed += describe_residual(stage.problem, fit, stage.split.seen, case.plant.machine)
    return outcome


def _read_off(case: Case, stages: Sequence[Stage], coarse: Coarse, outcome: Outcome) -> None:
    """The steps of a sensor get a name where its stage would stay above the noise that it is said to have."""
    outcome.repaired = outcome.repaired.with_effect(coarse.effect)
    share = max((_explained(case, stage, coarse) for stage in stages if coarse.signal in stage.problem.signals), default=0.0)
    if share >= MOST:
        found = {"step": coarse.step}, {"step": coarse.interval95}
        outcome.named.append(NamedEffect(coarse.effect.name, coarse.signal, *found, share))
    else:
        outcome.notes.append(
            f"{coarse.signal} reads in steps of {coarse.step:.4g}, more than the noise that it is said to have"
        )


def _explained(case: Case, stage: Stage, coarse: Coarse) -> float:
    """Share of what the sensor's stage leaves above the noise that it is said to have which its steps account for."""
    k = stage.problem.signals.index(coarse.signal)
    said = {**case.noise, coarse.signal: coarse.noise}
    floor = float(problem_floor(stage.problem, stage.theta, stage.split.fit, said, case.seed)[k])
    off = float(stage_rmse(stage.problem, stage.found.fit.theta, stage.split.held_out)[k])
    stepped = float(stage.sigma[k])
    return (min(off, stepped) - floor) / (off - floor) if min(off, stepped) > SHOWS * floor else 0.0


def _that_matter(stage: Stage, outcome: Outcome) -> Stage:
    """The stage without effects that explain next to nothing on held-out recordings, the least of them dropped first.

    Short-term evidence can be overwhelming for a mechanism that no physics of the catalogue has quite right; where it hardly
    changes what the plant predicts, it gets no name. Nor do a gain and a dead time that departed beside it alone.
    """
    finding = stage.found
    strange = stage.problem.integrates and finding.final_rmse > STRANGE
    while finding.named:
        full = held_out_score(stage, finding.fit.theta)
        dropped = {kept: _without(stage, finding.fit, kept.candidate) for kept in finding.named}
        scores = {kept: held_out_score(stage, fit.theta) for kept, fit in dropped.items()}
        least = min(finding.named, key=lambda kept: scores[kept])
        clear = not strange and scores[least] >= full and least.comparison.ratio > CLEARLY
        if clear or scores[least] >= MATTERS * full:
            break
        what = f"{least.candidate.effect.name} on {least.candidate.target}"
        if not least.candidate.nuisance:
            outcome.notes.append(
                f"{what} fits, but predicts held-out recordings hardly better ({scores[least] / full - 1.0:.1%}): no name"
            )
        named = tuple(k for k in finding.named if k is not least)
        if least.candidate.nuisance:  # others were found beside it, and mean what they mean only with it
            finding = replace(finding, named=named, adjusted=(*finding.adjusted, least.candidate))
        else:
            fit = dropped[least]
            alone = [k.candidate for k in named if k.candidate.nuisance and _shrank(k.candidate, finding, fit)]
            named = tuple(k for k in named if k.candidate not in alone)
            finding = replace(finding, named=named, adjusted=(*finding.adjusted, *alone), fit=fit)
    return replace(stage, finding=finding)


def _shrank(candidate: Candidate, finding: Finding, fit: Fit) -> bool:
    """Whether its departure was worth a name when it was found and is negligible in ``fit``."""
    return finding.fit.departure(candidate) > finding.leeway >= fit.departure(candidate)


def _without(stage: Stage, fit: Fit, candidate: Candidate) -> Fit:
    """The fit with one of its candidates dropped and the rest refitted."""
    rest = tuple(c for c in fit.candidates if c is not candidate)
    start = np.concatenate([fit.values_of(c) for c in rest]) if rest else np.empty(0)
    return fit_candidates(Data(stage.problem, stage.split.seen, stage.sigma), stage.theta, rest, [start])


def _accept(case: Case, stage: Stage, outcome: Outcome) -> None:
    seen = Data(stage.problem, stage.split.seen, stage.sigma)
    known = known_of(seen, stage.theta, stage.found.fit, case.noise, case.seed)
    finding = replace(stage.found, fit=known.fit)
    vague = [
        k
        for k in finding.named
        if k.candidate.known and k.comparison.ratio <= CLEARLY and not _departs_clearly(k.candidate, known.fit, known.limits)
    ]
    finding = replace(
        finding,
        named=tuple(k for k in finding.named if k not in vague),
        adjusted=(*finding.adjusted, *(k.candidate for k in vague)),
    )
    stage = replace(stage, finding=finding)
    for kept in finding.named:
        instance = kept.candidate.instance(finding.fit.values_of(kept.candidate))
        shown = ", ".join(f"{key} = {value}" for key, value in instance.parameters.items())
        if kept.candidate.key in {
            (e.name, e.target, e.side) for e in outcome.named
        }:  # a pump or a clock shows at several stages
            outcome.notes.append(f"{instance.name} on {instance.target} shows at the {stage.label} as well: {shown}")
            continue
        outcome.repaired = outcome.repaired.with_effect(instance)
        if kept.ties:
            tie = tuple((c.effect.name, c.target) for c in (kept.candidate, *kept.ties))
            outcome.ties.append(tie)
            outcome.notes.append(f"{instance.name} on {instance.target} stands in the plant for {len(tie)} that tie: {shown}")
        else:
            outcome.named.append(_named(stage, kept, known.limits))
    for candidate in finding.adjusted:
        values = finding.fit.values_of(candidate)
        outcome.repaired = outcome.repaired.with_effect(candidate.instance(values))
        shown = ", ".join(f"{u.key} = {v:.4g}" for u, v in zip(candidate.unknowns, values, strict=True))
        what = f"{candidate.effect.name} on {candidate.target}"
        outcome.notes.append(f"{what} adjusted, no finding of its own: {shown}")
    if finding.fit.candidates:
        outcome.repaired = outcome.repaired.with_uncertainty(_uncertainty(finding.fit, known.covariance))


def _departs_clearly(candidate: Candidate, fit: Fit, limits: Array) -> bool:
    """Whether any number of an effect that the plant has is further from its value there than :data:`CLEAR` half intervals."""
    nominal = np.array([unknown.nominal for unknown in candidate.unknowns])
    values, ends = fit.values_of(candidate), limits[fit.rows_of(candidate)]
    towards = np.where(nominal < values, ends[:, 0], ends[:, 1])
    return bool((np.abs(values - nominal) > CLEAR * np.abs(values - towards)).any())


def _uncertainty(fit: Fit, covariance: Array) -> Uncertainty:
    """What the fit of a stage says of the plant's parameters."""
    places = []
    for candidate in fit.candidates:
        name, target, side = candidate.key
        for parameter in candidate.form.parameters:
            places += [Place(name, target, side, parameter.name, k) for k in range(len(parameter.components))]  # type: ignore[arg-type]
    return Uncertainty(tuple(places), covariance)


def _named(stage: Stage, kept: Kept, limits: Array) -> NamedEffect:
    candidate, fit, compared = kept.candidate, stage.found.fit, kept.comparison
    begin = fit.rows_of(candidate).start
    parameters: dict[str, Value] = {}
    interval: dict[str, tuple[Any, Any]] = {}
    for parameter in candidate.form.parameters:
        here = slice(begin, begin + len(parameter.components))
        value, low, high = (tuple(map(float, column)) for column in (fit.values[here], limits[here, 0], limits[here, 1]))
        single = len(value) == 1
        parameters[parameter.name] = value[0] if single else value
        interval[parameter.name] = (low[0], high[0]) if single else (low, high)
        begin = here.stop
    return NamedEffect(
        candidate.effect.name,
        candidate.target,
        parameters,
        interval,
        _share(stage, candidate),
        tuple(Alternative(c.effect.name, c.target, why) for c, why in kept.rejected),
        candidate.aliases,
        side=candidate.side,
        evidence=Evidence(compared.delta_bic, compared.gain, compared.p_value, compared.ratio),
    )


def _share(stage: Stage, candidate: Candidate) -> float:
    """Closed share of the held-out stage gap that is lost when the effect is dropped and the rest refitted."""
    fit = stage.found.fit
    dropped = _without(stage, fit, candidate)
    closable = held_out_score(stage, stage.theta) - 1.0
    lost = held_out_score(stage, dropped.theta) - held_out_score(stage, fit.theta)
    return float(np.clip(lost / closable, 0.0, 1.0)) if closable > 0 else 0.0


def held_out_score(stage: Stage, theta: Array) -> float:
    """Held-out RMSE of the stage in noise floors."""
    return float(np.sqrt(np.nanmean((stage_rmse(stage.problem, theta, stage.split.held_out) / stage.sigma) ** 2)))


def with_carried(gap: Gap, outcome: Outcome) -> Gap:
    """The gap by stage, after the residual networks where they were accepted."""
    accepted = [item for item in outcome.carried if item.accepted]
    after = {**gap.after, **{item.signal: item.after for item in accepted}}
    return replace(gap, after=after, noise_floor={**gap.noise_floor, **{item.signal: item.noise_floor for item in accepted}})


def stage_gap(case: Case, stages: Sequence[Stage], repaired: Array) -> Gap:
    """RMSE of every stage driven by its measured input, on held-out recordings."""
    before: dict[str, float] = {}
    after: dict[str, float] = {}
    floor: dict[str, float] = {}
    for stage in stages:
        held_out = stage.split.held_out
        for values, scores in (
            (before, stage_rmse(stage.problem, case.theta, held_out)),
            (after, stage_rmse(stage.problem, repaired, held_out)),
            (floor, problem_floor(stage.problem, repaired, held_out, case.noise, case.seed)),
        ):
            values.update(zip(stage.problem.signals, map(float, scores), strict=True))
    return Gap(before, after, floor)
