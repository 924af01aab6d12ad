"""The fewest effects of a servo whose formulas are wrong.

The control loop of a servo, the inertia that it moves and the coupling of the joints are idealised. Small effects compensate
for them and change the values of the others: a bias takes part of the sag, since most of a gravity moment is constant. What
remains without them is as large within a tenth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from sysid.effects import joint_compliance, sensor_bias, sensor_scale
from sysid.gap.candidates import Candidate
from sysid.gap.likelihood.stage import ModelFit

#: Effects at rest: sag, bias and scale of the sensor. Each may replace the others where the gravity moment varies little.
AT_REST = (joint_compliance.EFFECT, sensor_bias.EFFECT, sensor_scale.EFFECT)
Refit = Callable[[Sequence[Candidate], ModelFit], ModelFit]


def fewest_sets(model: ModelFit, candidates: Sequence[Candidate], refit: Refit, tolerance: float) -> list[ModelFit]:
    """The model without effects that are not needed, then sets with another effect at rest in place of one of it.

    Args:
        candidates: of the stage.
        refit: fit of a set, begun at the values of a model.
        tolerance: a set may leave this multiple of what the model leaves, in noise floors.
    """
    limit = tolerance * max(model.left, 1.0)
    fewest = model
    while fewest.candidates:
        smaller = min((refit(_without(fewest, c), fewest) for c in fewest.candidates), key=lambda f: f.left)
        if smaller.left > limit:
            break
        fewest = smaller
    found = [fewest]
    for candidate in fewest.candidates:
        if candidate.effect in AT_REST:
            used = {c.key for c in fewest.candidates}
            others = [c for c in candidates if c.effect in AT_REST and c.key not in used and c.form is c.effect.forms[0]]
            swapped = (refit((*_without(fewest, candidate), other), fewest) for other in others)
            found += [f for f in swapped if f.left <= limit]
    return found


def _without(model: ModelFit, candidate: Candidate) -> tuple[Candidate, ...]:
    return tuple(c for c in model.candidates if c is not candidate)
