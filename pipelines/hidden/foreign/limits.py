"""The detection limit: the magnitude at which the error of the owner's plant in a free run rises by one noise floor.

The machine is simulated with and without the effect, and the owner's plant is driven by the same commands; the noise is added
by its standard deviation. Magnitudes without practical significance are excluded. A force axis is compared by its force at
measured motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import brentq

from hidden.foreign.excitation import Take
from hidden.foreign.machines import FORCE_AXIS, Tables, noise_of
from hidden.foreign.owner import Owner, recorded
from hidden.kinds import Kind
from hidden.limits import Limit, overlaid_lists
from sysid.datasets import Recording
from sysid.plant import compile_plant, free_run
from sysid.plant.force import ForceFilter, force_inputs
from sysid.plant.force_delay import force_delay
from sysid.signals import point_signals

#: Signal → RMSE of the owner's plant, in noise floors.
Scores = dict[str, float]

#: So many noise floors further off.
FURTHER = 1.0
#: Number of recordings.
LOOKS = 2
#: Least detection limits: smaller magnitudes have no practical significance. Delays and lags [s],
#: dead-bands [command], the others relative; other effects have no least limit.
PRACTICAL = {
    "input_delay": 0.005, "first_order_lag": 0.005, "gain_error": 0.01, "asymmetric_gain": 0.01, "flow_saturation": 0.01,
    "valve_deadband": 0.004, "sensor_scale": 0.002, "viscous_friction": 0.01, "inertia_error": 0.01,
}  # fmt: skip
#: Least noise floor as a share of the residual without noise.
LEAST = 0.05
#: Tolerance of the search (logarithm of the magnitude).
CLOSE = 0.1


def limit_of(kind: Kind, direction: int, known: Tables, scores: Callable[[Tables], Scores]) -> Limit:
    """The detection limit of ``kind`` on a machine.

    Args:
        scores: machine → RMSE by signal in noise floors, sensor noise included.
    """
    without = scores(known)

    def further(logarithm: float) -> float:
        changed = overlaid_lists(known, kind.change(known, math.exp(logarithm), direction))
        found = scores(changed)
        return max(found[signal] - value for signal, value in without.items()) - FURTHER

    low, high = math.log(max(1e-4 * kind.most, kind.least)), math.log(kind.most)
    base = max(without.values())
    if further(high) < 0.0:
        return Limit(math.inf, base)
    shows = math.exp(low if further(low) > 0.0 else brentq(further, low, high, xtol=CLOSE))
    return Limit(max(shows, PRACTICAL.get(kind.named[0][0], 0.0) if kind.named else 0.0), base)


def scores_of(kind: Kind, known: Tables, owner: Owner, noise: float, recordings: Sequence[Take]) -> Callable[[Tables], Scores]:
    """``scores`` of :func:`limit_of` for a machine, its owner, and the recordings of a case that begin at rest."""
    takes = recordings[:LOOKS]
    spread = noise_of(known, noise)
    if known["family"] in FORCE_AXIS:
        return _force_scores(known, owner, takes, spread)
    plant = owner.plant(known)
    signals = (
        point_signals("tool" if kind.stage == "tool" else "ee") if kind.target in ("ee", "tool") else (f"{kind.target}.joint",)
    )

    def scores(tables: Tables) -> Scores:
        squares = dict.fromkeys(signals, 0.0)
        for take in takes:
            recording = recorded(tables, take)
            run = free_run(plant, recording)
            for signal in signals:
                squares[signal] += float(np.nanmean((run[signal] - recording.values(signal)) ** 2)) / len(takes)
        return {signal: math.sqrt(1.0 + square / spread[signal] ** 2) for signal, square in squares.items()}

    return scores


def _force_scores(known: Tables, owner: Owner, takes: Sequence[Take], spread: dict[str, float]) -> Callable[[Tables], Scores]:
    """Residual of the owner's plant for the force at measured motion, filtered as in the plant."""
    model = compile_plant(owner.plant(known))
    axis = model.machine.axes[0]
    force, place = f"{axis.name}.command", f"{axis.name}.joint"
    first = recorded(known, takes[0])
    settings = ForceFilter(delay=force_delay([first], axis, ForceFilter()))

    def left(tables: Tables, noisy: bool) -> float:
        """Mean square of the residual [N²]."""
        parts = []
        for take in takes:
            table = recorded(tables, take).table
            if noisy:
                draw = np.random.default_rng([take.seed, 77])
                table = table.assign(**{s: table[s] + spread[s] * draw.standard_normal(len(table)) for s in (force, place)})
            seen = force_inputs(Recording(take.name, table, tables["rate"]), axis, settings)
            parts.append(seen.force - seen.model_force(model, model.theta[None], axis.name)[0])
        return float(np.mean(np.concatenate(parts) ** 2))

    base = left(known, noisy=False)
    floor = max(left(known, noisy=True) - base, LEAST * base)

    def scores(tables: Tables) -> Scores:
        return {force: math.sqrt(1.0 + left(tables, noisy=False) / floor)}

    return scores
