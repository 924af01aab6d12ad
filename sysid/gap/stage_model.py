"""One stage from its recordings to a decision: rows → variances → proposals → decision."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from sysid.gap.arm.sag import fewest_sets, sags
from sysid.gap.candidates import Candidate
from sysid.gap.data import SearchInput
from sysid.gap.decision import Decision, decide
from sysid.gap.free_run import LeastSquares, free_run_of
from sysid.gap.likelihood.discrepancy import discrepancy_of, timing_alone
from sysid.gap.likelihood.explained import Explained, explained
from sysid.gap.likelihood.rows import STATIC_SPAN, StageRows, averaged, averaged_out
from sysid.gap.likelihood.stage import ModelFit, StageLikelihood, fit_model
from sysid.gap.likelihood.variances import Start, estimated, first_variances, own_evidence, robust
from sysid.gap.proposals import Proposals
from sysid.machine import EffectKey

Array = npt.NDArray[np.float64]

#: A typical disturbance, as a share of the root-mean-square speed (or of the range, where nothing integrates).
TYPICAL = 0.01
#: First standard deviations of the discrepancy's coefficients, as shares of what a stage does: so small that the effects of the
#: catalogue enter first; larger where errors accumulate, beside the effects that explain the free run.
FIRST_TAU, FREE_RUN_TAU = 1e-5, 1e-3
#: Effects and variances are estimated alternately.
ROUNDS = 2
#: Where errors accumulate and a discrepancy gains this much beside the likeliest model [nats], the free run decides, and the
#: search around that model is left out.
MISSPECIFIED = 30.0
#: Transient of an unknown initial state: duration [s], and standard deviation as a share of the distance in that time.
TRANSIENT, INITIAL_SHARE = 0.4, 0.1


@dataclass(frozen=True)
class StageFit:
    """A stage after its search: the models and the decision.

    ``dropped``: by label, the chosen model without that effect, the rest refitted. ``remainder``: error that the discrepancy
    explains beside the chosen model. ``least_squares``: the smallest set that explains the output, fitted to the free run.
    ``names_alone``: the same with the named effects alone, where the chosen model has others. ``combinations``: sentences on
    combinations of parameters that static poses do not determine. ``framed``: of static poses, the model of the frame alone,
    against which the other effects are compared. ``cause``: of an error that no effect explains, where it is known.
    ``beside``: where errors accumulate, the smallest set with the further effect that leaves least of the free run, and
    that set without each effect of the smallest one, by label. ``open_loads``: of the links of an arm, by axis, the standard
    deviation of a constant load that the adjusted links may have instead [N·m or N].
    """

    models: tuple[ModelFit, ...]
    decision: Decision
    dropped: Mapping[str, ModelFit]
    remainder: Explained
    least_squares: ModelFit
    names_alone: StageFit | None = None
    combinations: tuple[str, ...] = ()
    framed: ModelFit | None = None
    cause: str = ""
    beside: tuple[ModelFit, Mapping[str, ModelFit]] | None = None
    open_loads: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class StageSearch:
    """The searched sets of effects of one stage, and what the decision asks of them.

    Args:
        free: least squares over the free run. bare: the likelihood without discrepancy.
        excited: candidates that the recordings excite; ``nameable``: their labels.
        sags: whether the stage is that of an axis that may sag under gravity.
        smallest: labels of the smallest sets that explain the free run, where errors accumulate.
    """

    proposals: Proposals
    free: LeastSquares
    start: Start
    bare: StageLikelihood
    excited: tuple[Candidate, ...]
    nameable: tuple[str, ...]
    sags: bool
    smallest: tuple[frozenset[str], ...]
    _evidence: dict[tuple[str, ModelFit], float] = field(default_factory=dict)

    def own_evidence(self, fit: ModelFit) -> float:
        """Evidence of a model with the discrepancy estimated beside it alone."""
        key = "own", fit
        if key not in self._evidence:
            self._evidence[key] = own_evidence(self.proposals.likelihood, self.start, fit)
        return self._evidence[key]

    def discrepancy_gain(self, fit: ModelFit) -> float:
        """Gain in evidence of a model by a discrepancy [nats]."""
        key = "gain", fit
        if key not in self._evidence:
            self._evidence[key] = fit.evidence - fit_model(self.bare, fit.candidates, fit.values[None]).evidence
        return self._evidence[key]

    @property
    def models(self) -> Sequence[ModelFit]:
        """Sets near the likeliest one, and those that explain the free run."""
        near = (*self.proposals.near(), *(self.proposals.fits[labels] for labels in self.smallest))
        return tuple({f.labels: f for f in near}.values())

    @property
    def integrates(self) -> bool:
        return self.proposals.likelihood.rows.problem.kind.integrates

    @property
    def independent(self) -> bool:
        return False

    @property
    def frame(self) -> frozenset[str]:
        return frozenset()

    def without(self, model: ModelFit, candidate: Candidate) -> ModelFit:
        return self.proposals.without(model, candidate)

    def fewest(self, model: ModelFit) -> Sequence[ModelFit] | None:
        return fewest_sets(model, self.excited, self.proposals.warm) if self.sags else None

    def decided(self, equivalence: Mapping[EffectKey, float], shared: Sequence[str]) -> StageFit:
        """The decision on the stage; ``equivalence`` and ``shared`` as in :func:`sysid.gap.decision.decide`."""
        proposals = self.proposals
        decision = decide(self, equivalence, shared)
        for _ in range(4):  # every survivor without each of its effects, until nothing new survives
            before = len(proposals.fits)
            for survivor in (decision.model, *decision.acceptable):
                for candidate in survivor.candidates:
                    proposals.without(survivor, candidate)
            if len(proposals.fits) == before:
                break
            decision = decide(self, equivalence, shared)
        fitted = _fitted(proposals, decision, self.free)
        if not decision.named or len(decision.named) == len(decision.model.candidates):
            return fitted
        names = _valued(proposals.warm(decision.named, decision.model), decision, self.free)
        alone = replace(decision, model=names, acceptable=(names,), tied=())
        return replace(fitted, names_alone=_fitted(proposals, alone, self.free))


def search_stage(given: SearchInput, timing: float) -> StageSearch:
    """Search one stage; ``timing``: error of timing between input and output [s], one standard deviation."""
    model, theta, candidates, nameable = given.model, given.theta, given.candidates, given.nameable
    problem, recordings, sigma = given.seen.problem, given.seen.recordings, given.seen.sigma
    full = recordings[0].rate_hz
    # Means over 0.1 s that are shifted by a clock error are wrong by several noise floors at every start and stop.
    clocks = any(c.effect.target == "stream" for c in candidates)
    span = STATIC_SPAN if problem.kind.static and not clocks else 0.0
    hidden = averaged_out(problem, recordings, theta, sigma, span)
    if span > 0.0:
        recordings = [averaged(problem.estimated(r), problem.kind) for r in recordings]
        problem = problem.by_estimates or problem
    rows = StageRows(problem, recordings, theta, sigma, hidden)
    samples = max(1, round(full / recordings[0].rate_hz)) * rows.series[0].width
    start = _start(rows, sigma, samples)
    extra = _transients(rows)
    # Beside a discrepancy, effects that the recordings do not excite would absorb the error of others: they come last there.
    excited = [c for c in candidates if c.label in nameable]
    nothing = timing_alone(rows, timing)
    free = free_run_of(rows, nothing if problem.kind.integrates else timing_alone(rows, 0.0), candidates)
    sets = free.smallest(nameable) if problem.kind.integrates else [free.proposals.fit(())]
    known = dict(free.proposals.fits)
    discrepancy = discrepancy_of(model, rows, theta, timing)
    variances = first_variances(rows, start, len(discrepancy.groups), FREE_RUN_TAU if problem.kind.integrates else FIRST_TAU)
    rich = sets[0]
    for _ in range(ROUNDS):
        first = Proposals(StageLikelihood(rows, discrepancy, variances, extra), excited, given.on_fit, known)
        rich = first.forward(first.warm(rich.candidates, rich))
        known |= first.fits
        del first, discrepancy  # the largest table of a stage, before the next one
        discrepancy = discrepancy_of(model, rows, rich.theta, timing)
        variances = estimated(rows, discrepancy, variances, start, extra, rich)
    variances = robust(StageLikelihood(rows, discrepancy, variances, extra), rich)
    likelihood = StageLikelihood(rows, discrepancy, variances, extra)
    proposals = Proposals(likelihood, candidates, given.on_fit, known)
    proposals.warm(rich.candidates, rich)

    bare = StageLikelihood(rows, nothing, replace(variances, groups=np.zeros(0)), extra)
    sagging, smallest = sags(problem, excited), tuple(f.labels for f in sets)
    search = StageSearch(proposals, free, start, bare, tuple(excited), tuple(nameable), sagging, smallest)
    proposals.forward(proposals.best)
    if not problem.kind.integrates or search.discrepancy_gain(proposals.best) < MISSPECIFIED:
        proposals.around()
    for fit in sets:
        proposals.warm(fit.candidates, fit)
    return search


def _fitted(proposals: Proposals, decision: Decision, free: LeastSquares) -> StageFit:
    model, smallest = decision.model, decision.acceptable[0]
    dropped = {c.label: _valued(proposals.without(model, c), decision, free) for c in model.candidates}
    remainder = explained(proposals.likelihood, model)
    squares = free.least_squares(smallest)
    beside = None
    if decision.accumulates and (extended := free.extended(squares)) is not None:
        beside = extended, {c.label: free.proposals.without(extended, c) for c in squares.candidates}
    return StageFit(tuple(proposals.near()), decision, dropped, remainder, squares, beside=beside)


def _valued(model: ModelFit, decision: Decision, free: LeastSquares) -> ModelFit:
    """A model with the values that the decision uses."""
    return model.with_values(free.least_squares(model)) if decision.accumulates else model


def _start(rows: StageRows, sigma: Array, samples: int) -> Start:
    """Noise of a row and a typical disturbance, by signal."""
    noise, typical = np.empty(len(sigma)), np.empty(len(sigma))
    for k in range(len(sigma)):
        parts = [s for s in rows.series if s.signal == k]
        noise[k] = max(float(sigma[k]) / np.sqrt(samples), 1e-12)
        output = np.concatenate([s.measured for s in parts])
        slopes = np.concatenate([np.diff(s.measured) / s.step[1:] for s in parts])
        if rows.problem.kind.integrates:
            typical[k] = TYPICAL * float(np.sqrt(np.nanmean(slopes**2)))
        else:
            typical[k] = TYPICAL * 0.3 * float(np.nanmax(output) - np.nanmin(output))
        typical[k] = max(typical[k], 0.1 * noise[k])
    return Start(noise, typical)


def _transients(rows: StageRows) -> list[Array]:
    """Variance added to the level of an integrating stage during the transient of an unknown initial state."""
    found = []
    for s in rows.series:
        extra = np.zeros(len(s.step))
        if rows.problem.kind.integrates:
            fast = float(np.nanpercentile(np.abs(np.diff(s.measured) / s.step[1:]), 95))
            for begin in np.flatnonzero(s.restart):
                count = max(1, round(TRANSIENT / max(float(np.median(s.step)), 1e-6)))
                extra[begin : begin + count] = (INITIAL_SHARE * TRANSIENT * fast) ** 2 / count
        found.append(extra)
    return found
