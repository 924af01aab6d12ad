"""Which of the effects that a fit has moved are worth a name: how sure, how large, and what may only make up for something.

Where errors add up over a run, a plant that is wrong in ways of its own moves the values of what it has by little, with
overwhelming evidence. So the more stays unexplained at such a stage, the more is asked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid.gap.candidates import Candidate
from sysid.gap.evidence import Comparison
from sysid.gap.fit import Fit
from sysid.gap.problem import Problem
from sysid.gap.scores import Scores
from sysid.gap.strictness import Strictness

#: An effect of which a curve of the speed over the command does more than this share is one.
MOSTLY = 0.5
#: What a sensor that reads too much, or too little, is called.
SCALE = "sensor_scale"


@dataclass(frozen=True)
class Worth:
    """The judgement at one stage. Where errors add up over a run, evidence says less than it seems to."""

    scores: Scores
    strict: Strictness
    problem: Problem

    # -- how much is left ----------------------------------------------------------------------------------------

    def strange(self, model: Fit) -> bool:
        """Whether the stage stays far from explained."""
        return self._left(model) >= self.strict.strange

    def leeway(self, model: Fit) -> float:
        """So many times what is negligible still is."""
        return float(np.clip(self._left(model), 1.0, self.strict.doubt))

    def _left(self, model: Fit) -> float:
        """Noise floors that are left where errors add up; else none."""
        return self.scores.rmse(model) if self.problem.integrates else 0.0

    def _strangeness(self, model: Fit) -> float:
        """0 where a stage counts as explained, 1 where it stays far from that."""
        span = self.strict.strange - self.strict.explained
        return float(np.clip((self._left(model) - self.strict.explained) / span, 0.0, 1.0))

    # -- how sure, how large -------------------------------------------------------------------------------------

    def lasts(self, c: Comparison, model: Fit) -> bool:
        """Whether evidence for an effect of ``model`` is enough to keep it."""
        if not self.strict.whitened:
            return c.delta_bic > self.strict.delta_bic
        strangeness = self._strangeness(model)
        if strangeness > 0.0 and c.ratio < 1.0 + (self.strict.clearer - 1.0) * strangeness:
            return False
        sure = c.p_value < self.strict.p_value
        likely = c.gain > self.strict.delta_bic and (c.p_value < self.strict.likely or c.ratio > self.strict.ratio)
        halved = c.gain > self.strict.forward and c.ratio > self.strict.halves
        return c.delta_bic > self.strict.delta_bic and (sure or likely or halved)

    def matters(self, candidate: Candidate, model: Fit, final: Fit | None = None) -> bool:
        """Whether a departure is large enough for a name: in itself (in a final fit too), or since everything depends on it.

        What ends at the bound of its range is no value of that effect: something else is passed off as it. A plant that errs
        in ways of its own moves the values of what it has by little, and much may depend on that: of these, more is asked.
        Where it leaves nothing of what was fitted, so that it does not err, the less is asked the further the departure is.
        """
        if model.at_bound(candidate):
            return False
        had = candidate.nuisance or candidate.known
        negligible = min(self.leeway(model), np.inf if had else self.strict.lacking)
        departure = min(fit.departure(candidate) for fit in (model, final or model))
        if departure > negligible:
            return True
        without = self.scores.without(candidate, model)
        most = np.inf if had else self.strict.doubt
        asked = self.strict.decides * float(np.clip(self.scores.rmse(model) / self.strict.explained, 1.0, most))
        if self.scores.fitted_rmse(model) <= self.strict.explained:
            asked *= (self.strict.clearer / asked) ** (departure / negligible)
        return all(figure(without) > asked * figure(model) for figure in (self.scores.rmse, self.scores.fitted_rmse))

    # -- what only makes up for something ------------------------------------------------------------------------

    def crumbs(self, model: Fit) -> list[Candidate]:
        """What explains little beside the strongest effect of a stage that stays far from explained.

        No formula is quite what a machine does: what is left there may be what the strongest one's is off by, and a second name
        what makes up for it. A spool that is slow to follow is a rate limit and, a little, another lag.
        """
        if not self.strange(model):
            return []
        shares = np.zeros(len(model.candidates))
        for figure in (self.scores.rmse, self.scores.fitted_rmse):
            left = np.array([figure(self.scores.without(c, model)) for c in model.candidates])
            own = np.sqrt(np.maximum(left**2 - figure(model) ** 2, 0.0))
            shares = np.maximum(shares, own / max(own.max(initial=0.0), 1e-12))
        return [c for c, share in zip(model.candidates, shares, strict=True) if share < self.strict.crumb]

    def misshapen(self, model: Fit) -> list[Candidate]:
        """Gains, curves and limits beside which a speed of no known form over the command tells nearly as much as they do.

        A clutch that slips looks like a gain and its curve, since these are the nearest that have a name.
        """
        if not self.strange(model) or not self.strict.whitened:
            return []
        static = [c for c in model.candidates if c.effect.memory(1.0) == 0]
        shares = self.scores.curved(model, [self.scores.without(c, model) for c in static])
        kind = [c for c, share in zip(static, shares, strict=True) if share > MOSTLY]
        if not kind:
            return []
        shapes = [c for c in kind if not c.nuisance] or kind  # a gain beside them is free with or without them
        smaller = self.scores.fit(tuple(c for c in model.candidates if c not in shapes), (model,))
        named = self.scores.told(model) - self.scores.told(smaller)
        beyond = np.array(self.scores.beyond(model))
        return kind if np.all(beyond > np.maximum(self.strict.shapeless * named, self.strict.delta_bic)) else []

    def droops(self, model: Fit) -> list[Candidate]:
        """The scale of a servo's own sensor, where the servo stays far from explained.

        A controller that is too weak for what it carries falls short of its setpoint, by less with more gain and by more with
        more weight. Setpoint and sensor alone cannot tell that from a sensor that reads too little.
        """
        servo = self.problem.stage == "command" and not self.problem.integrates
        if not servo or self.scores.rmse(model) < self.strict.strange:
            return []
        return [c for c in model.candidates if c.effect.name == SCALE]
