"""The fewest effects at rest of a servo whose formulas are wrong: sag under its gravity moment, bias and scale of its sensor.

The control loop of a servo, the inertia that it moves and the coupling of the joints are idealised. A bias that compensates for
them takes part of the sag, since most of a gravity moment is constant; what remains without it is as large within a tenth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from sysid.effects import joint_compliance, sensor_bias, sensor_scale
from sysid.gap.candidates import Candidate
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.problem import Problem
from sysid.machine import Machine

#: Each may replace the others where the gravity moment varies little.
AT_REST = (joint_compliance.EFFECT, sensor_bias.EFFECT, sensor_scale.EFFECT)
Refit = Callable[[Sequence[Candidate], ModelFit], ModelFit]


def sags(machine: Machine, problem: Problem, candidates: Sequence[Candidate]) -> bool:
    """Whether the stage is that of a position axis that may sag under a gravity moment that the recordings vary."""
    if problem.stage != "command" or machine.axis(problem.target).actuation != "position":
        return False
    return any(c.effect is joint_compliance.EFFECT for c in candidates)


def fewest_sets(model: ModelFit, candidates: Sequence[Candidate], refit: Refit, tolerance: float) -> list[ModelFit]:
    """The model without effects at rest that are not needed, then sets with another one in place of one of it.

    Args:
        candidates: of the stage.
        refit: fit of a set, begun at the values of a model.
        tolerance: a set may leave this multiple of what the model leaves, in noise floors.
    """
    limit = tolerance * max(model.left, 1.0)
    fewest = model
    while here := [c for c in fewest.candidates if c.effect in AT_REST]:
        smaller = min((refit(_without(fewest, c), fewest) for c in here), key=lambda f: f.left)
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
