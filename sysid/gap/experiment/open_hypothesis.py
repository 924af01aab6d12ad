"""Open hypotheses: models among which the recordings do not decide, and the information expected from a further recording.

They are effects that are not identifiable, and effects of an unexplained stage that its recordings do not excite.

T-optimality (Atkinson & Fedorov, Biometrika 62 (1975) 57 and 289): data are simulated with one model, the alternative is fitted
to them, and its residual is evaluated. Whitened by noise floor and drift, half its sum of squares is the Kullback-Leibler
divergence of the alternative in nats: the expected log-likelihood ratio of the recording. Earlier recordings constrain the
parameters of the alternative by their Fisher information (sequential design: Pronzato, Automatica 44 (2008) 303).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from sysid.datasets.recording import Recording
from sysid.gap.candidates import Candidate, Unknown
from sysid.gap.data import Data, joined
from sysid.gap.drift import BIN, CLIP, DriftStrength, estimate_drift, to_bins, whiten_lanes
from sysid.gap.excitation import excitation_of
from sysid.gap.experiment.experiment import EffectAt
from sysid.gap.fit import Fit, fit_candidates, jacobian, place, starting_values
from sysid.gap.prepare.case import Case, Stage, stage_candidates
from sysid.gap.problem import Problem
from sysid.gap.proof import ProofOutcome
from sysid.gap.thresholds import at_floor
from sysid.plant import compile_plant

Array = npt.NDArray[np.float64]

#: Largest number of models in one open hypothesis; those that fit best are used.
MAX_ALTERNATIVES = 4
#: Share of the drift that is left after 0.1 s at a stage that does not integrate: its memory is about a second.
MEMORY = 0.9


@dataclass(frozen=True)
class PlausibleModel:
    """A model that may be the true one.

    Args:
        candidate: the effect that distinguishes it; None for the model without that effect.
        values: of ``unknowns``, (k,).
        theta: the whole parameter vector with them in place.
        known: Fisher information of the unknowns from the recordings so far, (k, k).
    """

    candidate: Candidate | None
    unknowns: tuple[Unknown, ...]
    values: Array
    theta: Array
    known: Array


@dataclass(frozen=True)
class OpenHypothesis:
    """Models of one stage among which the recordings do not decide.

    Args:
        models: at least two. For an effect that is not excited: the model with the effect, then the model without it.
        drifts: drift of each signal of the stage if one of the models is true. It is overestimated where an effect is missing.
    """

    kind: Literal["tie", "excitation"]
    stage: Stage
    models: tuple[PlausibleModel, ...]
    drifts: tuple[DriftStrength, ...]

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        return tuple(model.candidate for model in self.models if model.candidate is not None)

    @property
    def effects(self) -> tuple[EffectAt, ...]:
        return tuple(EffectAt(c.effect.name, c.target) for c in self.candidates)

    @property
    def label(self) -> str:
        return " or ".join(f"{effect.name} on {effect.target}" for effect in self.effects)

    @property
    def pairs(self) -> tuple[tuple[PlausibleModel, PlausibleModel], ...]:
        """(true model, alternative) to be discriminated; no data reject an alternative that contains the true model."""
        if self.kind == "excitation":
            return ((self.models[0], self.models[1]),)
        return tuple((a, b) for a in self.models for b in self.models if a is not b and not _is_special_case(a, b))


def _is_special_case(model: PlausibleModel, of: PlausibleModel) -> bool:
    assert model.candidate is not None
    assert of.candidate is not None
    return of.candidate.contains(model.candidate) or of.candidate.extends(model.candidate)


# -- hypotheses of a result -----------------------------------------------------------------------------------------------


def open_hypotheses(case: Case, stages: Sequence[Stage], outcome: ProofOutcome) -> list[OpenHypothesis]:
    """The non-identifiable sets of the outcome, then the effects that unexplained stages may have and do not excite."""
    model = compile_plant(outcome.repaired)
    base = model.theta
    searched = [stage for stage in stages if stage.result is not None]
    if model.rigid is not None:  # motions are planned for one axis; the forces of an arm depend on all of them
        searched = [stage for stage in searched if not stage.problem.kind.is_force]
    found = []
    for stage in searched:
        seen = Data(stage.problem, stage.split.seen, stage.sigma)
        for kept in stage.found.named:
            tie = tuple((c.effect.name, c.target) for c in (kept.candidate, *kept.ties))
            if kept.ties and tie in outcome.ties:
                found.append(non_identifiable_set(case, stage, base, kept.candidate, kept.ties[: MAX_ALTERNATIVES - 1], seen))
    for stage in searched:
        if not at_floor(stage.found.nominal_rmse):
            found += _unexcited(case, stage, base)
    return found


def non_identifiable_set(
    case: Case, stage: Stage, base: Array, kept: Candidate, alternatives: Sequence[Candidate], seen: Data
) -> OpenHypothesis:
    """``kept``, an effect of the final fit of the stage, against ``alternatives``, each fitted in its place.

    Args:
        base: parameters of the repaired plant, (N,).
        seen: the recordings that the fit has seen.
    """
    fit = stage.found.fit
    drifts, _ = estimated_drifts(seen, seen.bins(fit.theta[None]))
    models = [plausible_model(base, kept, fit.unknowns, fit.values, seen, drifts)]
    for alternative in alternatives:
        rest = tuple(c for c in fit.candidates if c is not kept and c.key != alternative.key)
        candidates = (*rest, alternative)
        refitted = fit_candidates(seen, case.theta, candidates, starting_values(candidates, (fit,), case.seed))
        # Effects that the alternative does not need are absent, not those of the repaired plant.
        absent = _as_in(base, case.theta, fit)
        models.append(plausible_model(absent, alternative, refitted.unknowns, refitted.values, seen, drifts))
    return OpenHypothesis("tie", stage, tuple(models), drifts)


def _unexcited(case: Case, stage: Stage, base: Array) -> list[OpenHypothesis]:
    """Effects that the recordings do not excite enough, those among them that are adjusted in the plant: there, or absent."""
    seen = Data(stage.problem, stage.split.seen, stage.sigma)
    fit = stage.found.fit
    excited = tuple(c for c in fit.candidates if excitation_of(c, stage.split.seen, case.plant.machine).sufficient)
    if len(excited) < len(fit.candidates):
        base = _as_in(base, case.theta, fit)
        start = np.concatenate([np.empty(0), *(fit.values_of(c) for c in excited)])
        fit = fit_candidates(seen, stage.theta, excited, [start])
    elif at_floor(stage.found.final_rmse):
        return []
    used = {c.key for c in fit.candidates}
    noise = noise_of_bin(stage.problem.rate(stage.split.seen[0]))
    calm = (DriftStrength(noise=noise, memory=_memory(stage.problem)),) * len(stage.sigma)
    found = []
    for candidate in stage_candidates(case, stage):
        if candidate.form is not candidate.effect.forms[0] or candidate.key in used:
            continue
        if excitation_of(candidate, stage.split.seen, case.plant.machine).sufficient:
            continue
        values = np.concatenate([fit.values, relevant_size(candidate)])
        there = plausible_model(base, candidate, (*fit.unknowns, *candidate.unknowns), values, seen, calm)
        absent = plausible_model(base, None, fit.unknowns, fit.values, seen, calm)
        found.append(OpenHypothesis("excitation", stage, (there, absent), calm))
    return found


def plausible_model(
    base: Array,
    candidate: Candidate | None,
    unknowns: Sequence[Unknown],
    values: Array,
    seen: Data,
    drifts: Sequence[DriftStrength],
) -> PlausibleModel:
    """A model with the information of the recordings ``seen`` on its parameters; ``base`` (N,) gives all others."""
    unknowns = tuple(unknowns)
    known = np.zeros((len(unknowns), len(unknowns)))
    if unknowns:
        slopes = jacobian(partial(whitened, seen, drifts), base, unknowns, values)
        known = slopes.T @ slopes
    return PlausibleModel(candidate, unknowns, values, place(base, unknowns, values[None])[0], known)


def relevant_size(candidate: Candidate) -> Array:
    """A small relevant size of the effect: its start value nearest to nominal, at least five times negligible, (k,)."""
    nominal = np.array([u.nominal for u in candidate.unknowns])
    negligible = np.array([u.negligible for u in candidate.unknowns])

    def size(row: Array) -> float:
        return float(np.max(np.abs(row - nominal) / negligible))

    clear = [row for row in map(np.array, candidate.starts) if size(row) >= 5.0]
    if clear:
        return min(clear, key=size)
    low, high = (np.array([u.bounds[k] for u in candidate.unknowns]) for k in (0, 1))
    up = nominal + 5.0 * negligible
    return np.clip(np.where(up <= high, up, nominal - 5.0 * negligible), low, high)


def _as_in(base: Array, theta: Array, fit: Fit) -> Array:
    """``base`` with all parameters of ``fit`` set to their values in ``theta``."""
    out = base.copy()
    for unknown in fit.unknowns:
        out[list(unknown.places)] = theta[list(unknown.places)]
    return out


# -- expected information -------------------------------------------------------------------------------------------------


def discrimination(
    data: Data, truth: PlausibleModel, alternative: PlausibleModel, drifts: Sequence[DriftStrength], seed: int = 0
) -> tuple[float, float]:
    """Expected difference between ``truth`` and ``alternative`` in a recording.

    Args:
        data: recordings simulated with ``truth``, without noise.

    Returns:
        Expected log-likelihood ratio after the alternative has been refitted [nats], and the error of its prediction before
        that [noise floors]. Nats are the smaller of two values: with the known drift (``drifts``), and with the drift estimated
        for each model after noise is added, as in the workflow, where an alternative may fit a residual that it cannot explain
        as drift.
    """
    best = _refitted(data, alternative, drifts)
    own, left = (0.5 * float(np.sum(_clipped(data, theta, drifts) ** 2)) for theta in (truth.theta, best))
    estimated = _log_likelihood(data, truth.theta, seed) - _log_likelihood(data, best, seed)
    error = np.concatenate([part.ravel() for part in data.residuals(alternative.theta[None])])
    return max(min(left - own, estimated), 0.0), math.sqrt(1.0 + float(np.nanmean(error**2)))


def _refitted(data: Data, alternative: PlausibleModel, drifts: Sequence[DriftStrength]) -> Array:
    """Parameter vector of the alternative, fitted to ``data`` and its prior information, (N,)."""
    unknowns = alternative.unknowns
    if not unknowns:
        return alternative.theta
    low, high = (np.array([u.bounds[k] for u in unknowns]) for k in (0, 1))
    root = _root(alternative.known)

    def theta(x: Array) -> Array:
        return np.asarray(place(alternative.theta, unknowns, x[None])[0])

    def errors(x: Array) -> Array:
        return np.concatenate([_clipped(data, theta(x), drifts), root @ (x - alternative.values)])

    def slopes(x: Array) -> Array:
        return np.vstack([jacobian(partial(whitened, data, drifts), alternative.theta, unknowns, x, high), root])

    margin = 1e-9 * (high - low)
    scale = np.array([u.negligible for u in unknowns])
    start = np.clip(alternative.values, low + margin, high - margin)
    return theta(least_squares(errors, start, slopes, (low, high), x_scale=scale, max_nfev=12).x)


def _clipped(data: Data, theta: Array, drifts: Sequence[DriftStrength]) -> Array:
    return np.asarray(np.clip(whitened(data, drifts, theta[None])[0], -CLIP, CLIP))


def whitened(data: Data, drifts: Sequence[DriftStrength], thetas: Array) -> Array:
    """Residuals of parameter vectors (lanes, N) whitened by the drift of each signal, (lanes, n)."""
    parts = data.bins(thetas)
    for part, recording in zip(parts, data.recordings, strict=True):
        for k, drift in enumerate(drifts):
            if drift.present:
                part[:, :, k] = whiten_lanes(part[:, :, k], _activity(data.problem, recording), drift)
            part[:, :, k] /= drift.noise
    return joined(parts)


def estimated_drifts(data: Data, bins: Sequence[Array]) -> tuple[tuple[DriftStrength, ...], float]:
    """Drift of each signal in binned residuals, one (1, m, d) a recording, and the log-likelihood of all [nats]."""
    activities = [_activity(data.problem, recording) for recording in data.recordings]
    series = [[part[0, :, k] for part in bins] for k in range(len(data.sigma))]
    found = [estimate_drift(each, activities, _memory(data.problem)) for each in series]
    return tuple(drift for drift, _ in found), float(sum(total for _, total in found))


def _memory(problem: Problem) -> float:
    return 1.0 if problem.kind.integrates else MEMORY


def _activity(problem: Problem, recording: Recording) -> Array:
    """Activity of the stage in each bin, mean 1, (m,); constant where it does not move.

    Flow disturbances grow with the flow: a drive drifts in motion and hardly at rest.
    """
    measured = to_bins(problem.measured(recording), problem.rate(recording))
    if not problem.kind.integrates or len(measured) < 3:
        return np.ones(len(measured))
    rows = np.arange(len(measured))
    there = ~np.isnan(measured[:, 0])
    if there.sum() < 3:
        return np.ones(len(measured))
    moved = np.abs(np.gradient(np.interp(rows, rows[there], measured[there, 0])))
    mean = float(moved.mean())
    return moved / mean if mean > 0 else np.ones(len(measured))


def _root(information: Array) -> Array:
    """R with RᵀR = the matrix, which may be singular."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T * scale)


def _log_likelihood(data: Data, theta: Array, seed: int) -> float:
    """Log-likelihood of the residuals with noise on every bin, under the drift estimated from them."""
    rng = np.random.default_rng(seed)
    noisy = [
        bins + rng.normal(0.0, noise_of_bin(data.problem.rate(recording)), bins.shape)
        for bins, recording in zip(data.bins(theta[None]), data.recordings, strict=True)
    ]
    return estimated_drifts(data, noisy)[1]


def noise_of_bin(rate_hz: float) -> float:
    """Standard deviation of the mean of a bin of white noise, relative to that of a sample."""
    return 1.0 / math.sqrt(max(1, round(BIN * rate_hz)))


def precision(data: Data, model: PlausibleModel, drifts: Sequence[DriftStrength]) -> Array:
    """Standard deviations of the unknowns of ``model`` from these and all earlier recordings, (k,): Cramér-Rao bound."""
    slopes = jacobian(partial(whitened, data, drifts), model.theta, model.unknowns, model.values)
    information = model.known + slopes.T @ slopes
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-10, hermitian=True)
    return np.asarray(np.sqrt(np.maximum(np.diag(inverse), 0.0)) / scale)
