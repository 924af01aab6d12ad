"""How often the chart raises a false alarm, on the scatter of identified values.

A thousand hours cannot be simulated and identified here. The identified values of recordings in which nothing changes are
standardised by machine and parameter, pooled, and drawn again with replacement, all parameters of a recording together. This
keeps their distribution and their correlation with each other; that recordings are independent is an assumption, which the
correlation of neighbours checks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import stats

from sysid.fleet.drift import drifts
from sysid.fleet.effects import ParameterHistory

Array = npt.NDArray[np.float64]


def pooled(machines: Sequence[Sequence[ParameterHistory]]) -> tuple[Array, Array, float]:
    """Standardised values and relative deviations (rows, parameters), and the correlation of neighbours.

    Args:
        machines: for each machine the histories of the same parameters over recordings without a change.
    """
    values, deviations, neighbours = [], [], []
    for histories in machines:
        own = np.array([h.values for h in histories]).T
        spread = own.std(axis=0, ddof=1)
        z = (own - own.mean(axis=0)) / spread
        values.append(z)
        deviations.append(np.array([h.deviations for h in histories]).T / spread)
        neighbours.append(z[:-1] * z[1:])
    return np.concatenate(values), np.concatenate(deviations), float(np.concatenate(neighbours).mean())


def measured(
    histories: Sequence[ParameterHistory], rows: tuple[Array, Array], seconds: float, hours: int, seed: int
) -> dict[str, Any]:
    """False alarms of machines that are watched for 1000 h each.

    Args:
        histories: of one machine, for the parameters and what is negligible.
        rows: of :func:`pooled`. seconds: length of a recording. hours: in total.
    """
    count = round(1000 * 3600 / seconds)
    names = tuple(map(str, range(count)))
    ends = tuple((np.arange(1, count + 1) * seconds / 3600.0).tolist())
    charts, reported = 0, 0
    for machine in range(hours // 1000):
        chosen = np.random.default_rng([seed, machine]).integers(0, len(rows[0]), count)
        for k, history in enumerate(histories):
            spread = float(np.std(history.values, ddof=1))
            values, deviations = (spread * part[chosen, k] for part in rows)
            made = [
                ParameterHistory(
                    "simulated", history.effect, history.parameter, history.unit, negligible, names, ends,
                    tuple(values.tolist()), tuple(deviations.tolist()),
                )
                for negligible in (0.0, history.negligible)
            ]  # fmt: skip
            # One parameter has its share of the accepted rate.
            share = 1e-3 / len(histories)
            alarms = len(drifts(made[:1], share))
            charts += alarms
            reported += len(drifts(made[1:], share)) if alarms else 0
    return {
        "hours": hours,
        "chart": charts,
        "chart_upper95_per_1000_h": _upper(charts, hours),
        "reported": reported,
        "reported_upper95_per_1000_h": _upper(reported, hours),
    }


def _upper(count: int, hours: int) -> float:
    """Upper 95 % limit of a Poisson rate per 1000 h (Garwood, Biometrika 28 (1936), 437)."""
    return float(stats.chi2.ppf(0.95, 2 * count + 2) / 2.0 / hours * 1000.0)
