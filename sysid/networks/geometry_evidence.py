"""Which optional parameters of a geometry the poses support: comparison by Bayesian evidence.

At a fit the model is linear, y = X·β + e, with β ~ N(0, 1) in units of the priors and e ~ N(0, s²) in units of the stated
noise. Any subset of the parameters then has its evidence in closed form, with the noise s at its maximum (type II likelihood):

    log Z = −N·log s − ½·log|1 + H/s²| − ½·(yᵀy − bᵀ(H + s²)⁻¹b)/s²        H = XᵀX, b = Xᵀy

A compliance is not negative: its prior is the half of a Gaussian above zero, which multiplies Z by 2·Φ(mean/deviation) of its
posterior. Scales, compliances and lateral compliances enter one after the other, the most probable first, leave again where
they are not needed any more, and are exchanged for others, until no step raises the evidence by :data:`MIN_GAIN`.

Sources: MacKay, Neural Computation 4 (1992), 415–447 (evidence); Kass and Raftery, J. Am. Stat. Assoc. 90 (1995), 773–795: a
Bayes factor of 20, log 3, is strong evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.special import log_ndtr

from sysid.networks.pose_fit import PoseFit

Array = npt.NDArray[np.float64]
Set = frozenset[int]

#: Least gain of an accepted parameter, and below which two alternatives are a tie [nats].
MIN_GAIN = 3.0
#: Standard deviation of the noise about the stated noise (natural logarithm), where one is stated.
NOISE_SPREAD = 1.0
#: Noise levels at which the evidence is evaluated, in steps of a fifth of e.
_LEVELS = np.exp(np.arange(-8.0, 8.0, 0.1))
_MOST_STEPS = 100


@dataclass(frozen=True)
class Support:
    """Support of one optional parameter in the selected model.

    Args:
        gain: log evidence lost without it [nats].
        alternative: key of the parameter that would replace it best, where the evidence would fall by less than
            :data:`MIN_GAIN`: the poses do not distinguish the two.
    """

    gain: float
    alternative: str | None


@dataclass
class SubsetEvidence:
    """Log evidence of subsets of the optional parameters beside those that are always estimated.

    Args:
        fit: of a model in which all of them were free.
        noise_stated: whether the noise of the points is known up to :data:`NOISE_SPREAD`.
    """

    fit: PoseFit
    noise_stated: bool
    known: dict[Set, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        fit = self.fit
        free = np.flatnonzero(fit.free)
        priors = fit.geometry.priors[free]
        root = np.sqrt(fit.weights)[:, None]
        columns = root * fit.slopes
        target = root[:, 0] * (fit.residual + fit.slopes @ (fit.values[free] / priors))
        self._products, self._slope, self._square = columns.T @ columns, columns.T @ target, float(target @ target)
        self._rows = len(target)
        self._place = {int(parameter): place for place, parameter in enumerate(free)}
        optional = fit.geometry.optional
        self._always = [self._place[int(parameter)] for parameter in free if not optional[parameter]]
        self.candidates = tuple(int(parameter) for parameter in free if optional[parameter])

    def __call__(self, members: Set) -> float:
        if members not in self.known:
            self.known[members] = self._evidence(members)
        return self.known[members]

    def _evidence(self, members: Set) -> float:
        places = np.array([*self._always, *(self._place[parameter] for parameter in sorted(members))], dtype=np.intp)
        strengths, directions = np.linalg.eigh(self._products[np.ix_(places, places)])
        strengths = np.maximum(strengths, 0.0)
        along = directions.T @ self._slope[places]
        square = _LEVELS[:, None] ** 2
        explained = (along**2 / (strengths + square)).sum(axis=1)
        value = -self._rows * np.log(_LEVELS) - 0.5 * (self._square - explained) / square[:, 0]
        value -= 0.5 * np.log1p(strengths / square).sum(axis=1)
        if self.noise_stated:
            value -= 0.5 * (np.log(_LEVELS) / NOISE_SPREAD) ** 2
        best = int(np.argmax(value))
        square = float(square[best, 0])
        mean = directions @ (along / (strengths + square))
        variance = (directions**2 / (strengths / square + 1.0)).sum(axis=1)
        elastic = self.fit.geometry.elastic
        one_sided = [k for k, parameter in enumerate(sorted(members), len(self._always)) if elastic[parameter]]
        half = np.log(2.0) + log_ndtr(mean[one_sided] / np.sqrt(variance[one_sided]))
        return float(value[best] + half.sum())

    def selected(self, start: Set = frozenset()) -> Set:
        """The subset from which no addition, exchange or removal raises the evidence by :data:`MIN_GAIN`."""
        best = start
        for _ in range(_MOST_STEPS):
            for neighbours, price in ((self._smaller(best), -MIN_GAIN), (self._larger(best), MIN_GAIN)):
                found = max(neighbours, key=self, default=best)
                if found != best and self(found) > self(best) + price:
                    best = found
                    break
            else:
                exchanged = max(self._exchanged(best), key=self, default=best)
                if self(exchanged) <= self(best) + 1e-6:
                    return best
                best = exchanged
        return best

    def support(self, members: Set) -> dict[int, Support]:
        """Of every member of a subset."""
        keys = [parameter.key for parameter in self.fit.geometry.parameters]
        found = {}
        for parameter in sorted(members):
            rest = members - {parameter}
            alternative = max(
                (other for other in self.candidates if other not in members),
                key=lambda other: self(rest | {other}),
                default=None,
            )
            instead = None
            if alternative is not None and self(rest | {alternative}) > self(members) - MIN_GAIN:
                instead = keys[alternative]
            found[parameter] = Support(self(members) - self(rest), instead)
        return found

    def _larger(self, members: Set) -> list[Set]:
        return [members | {parameter} for parameter in self.candidates if parameter not in members]

    def _smaller(self, members: Set) -> list[Set]:
        return [members - {parameter} for parameter in sorted(members)]

    def _exchanged(self, members: Set) -> list[Set]:
        """One parameter for one other of the same joint or of the same kind."""
        parameters = self.fit.geometry.parameters
        return [
            (members - {old}) | {new}
            for old in sorted(members)
            for new in self.candidates
            if new not in members
            and (parameters[old].joint == parameters[new].joint or parameters[old].kind == parameters[new].kind)
        ]
