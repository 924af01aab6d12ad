"""What the named repair is compared with: a fixed structure fitted without names, and the plant of the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from loop.deployment import Deployment
from loop.rounds import Site, fly_paths
from loop.score import figures_of
from sysid.datasets import Dataset, Recording
from sysid.errors import SettingsError
from sysid.machine import Axis, KnownEffect
from sysid.plant import Plant, compile_plant

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FreeParameter:
    """A parameter of the fixed structure; ``step``: finite difference of the fit, above the kinks of a sampled delay."""

    effect: str
    names: tuple[str, ...]
    low: float
    high: float
    step: float
    neutral: float = 0.0


LAG_DELAY_GAIN = (
    FreeParameter("input_delay", ("delay",), 0.0, 0.3, 2e-3),
    FreeParameter("first_order_lag", ("time_constant",), 1e-3, 0.3, 2e-3),
    FreeParameter("gain_error", ("ratio",), 0.05, 2.0, 5e-3, 1.0),
)
#: The same with one dead-band for both sides.
WITH_DEADBAND = (*LAG_DELAY_GAIN, FreeParameter("valve_deadband", ("positive", "negative"), 0.0, 0.7, 5e-3))
#: Half-width of the guessed randomisation, relative to the nominal value, and its number of samples.
GUESS, SAMPLES = 0.2, 64
#: Number of the first run of a compared controller, above those of the rounds.
FIRST_RUN = 100
#: Displacements over this time are compared [s]: over whole runs the errors of a wrong structure add up to a drift.
SPAN_S = 1.0


def fixed_structure(plant: Plant, dataset: Dataset, structure: tuple[FreeParameter, ...]) -> Plant:
    """The plant with the parameters of a structure on every axis by least squares, everything else as it is.

    The held-out recordings are left out, as in the gap workflow.
    """
    recordings = [each for each in dataset.recordings if dataset.splits[each.name] != "held_out"]
    for axis in plant.machine.axes:
        plant = _fitted(plant, axis, recordings, structure)
    return plant


def _fitted(plant: Plant, axis: Axis, recordings: Sequence[Recording], structure: tuple[FreeParameter, ...]) -> Plant:
    def with_values(values: Array) -> Plant:
        changed = plant
        for free, value in zip(structure, values, strict=True):
            changed = changed.with_effect(KnownEffect(free.effect, axis.name, dict.fromkeys(free.names, float(value))))
        return changed

    def residuals(values: Array) -> Array:
        model, parts = compile_plant(with_values(values)), []
        for recording in recordings:
            error = model.drive(model.theta[None], recording, axis.name)[0] - recording.values(axis.driven)
            span = round(SPAN_S * recording.rate_hz)
            moved = error[span:] - error[:-span]
            parts.append(moved[np.isfinite(moved)])
        return np.concatenate(parts)

    low, high, step = (np.array([getattr(free, key) for free in structure]) for key in ("low", "high", "step"))
    start = np.clip([_value(plant, free, axis.name) for free in structure], low + step, high - step)
    found = least_squares(residuals, start, bounds=(low, high), diff_step=step / start, x_scale=high - low, max_nfev=20)
    return with_values(found.x)


def _value(plant: Plant, free: FreeParameter, target: str) -> float:
    known = plant.effect(free.effect, target)
    return free.neutral if known is None else float(np.mean([np.mean(known.parameters[name]) for name in free.names]))


def guessed_plant(nominal: Plant, draw: np.random.Generator) -> Plant:
    """A plant whose controller is robust to a guess: the parameters of every valve are uncertain by :data:`GUESS`.

    Of :data:`SAMPLES` plants it has the mean gain and dead-band, by which the controller inverts the valve, and the largest
    dead time and lag, for which its feedback is stable.
    """
    plant = nominal
    for axis in nominal.machine.axes:
        for free in WITH_DEADBAND:
            known = nominal.effect(free.effect, axis.name)
            middle = {name: free.neutral if known is None else float(known.parameters[name]) for name in free.names}
            factors = draw.uniform(1.0 - GUESS, 1.0 + GUESS, (SAMPLES, len(free.names)))
            chosen = factors.max(axis=0) if free.effect in ("input_delay", "first_order_lag") else factors.mean(axis=0)
            values = {name: middle[name] * float(factor) for name, factor in zip(free.names, chosen, strict=True)}
            plant = plant.with_effect(KnownEffect(free.effect, axis.name, values))
    return plant


def true_plant(nominal: Plant, hidden: Sequence[Mapping[str, Any]], parked: Mapping[str, float]) -> Plant:
    """The nominal plant with the hidden effects.

    Args:
        parked: joints of the parked machine, where the backlash of a cylinder [m] is converted to that of its joint [rad].
    """
    plant = nominal
    for each in hidden:
        name, target, parameters = str(each["name"]), str(each["target"]), dict(each["parameters"])
        if name == "backlash" and target in plant.linkages:
            linkage, width = plant.linkages[target], parameters["width"]
            middle = float(linkage.displacement(np.array([parked[target]]))[0])
            ends = linkage.joint(np.array([middle - 0.5 * width, middle + 0.5 * width]))
            parameters["width"] = float(abs(ends[1] - ends[0]))
        side = "drive" if name == "backlash" else None
        plant = plant.with_effect(KnownEffect(name, target, parameters, side))
    return plant


def deployed(site: Site, deployment: Deployment, name: str) -> dict[str, Any]:
    """Figures of the helix under a deployment; its logs are not those of the loop.

    The runs are numbered from :data:`FIRST_RUN` on whatever the plant, so that controllers are compared under the same noise. A
    path that the runner refuses has no figures, and the reason in ``why``.
    """
    site.runs = FIRST_RUN
    try:
        return figures_of(fly_paths(site, deployment, ("helix",), site.folder / f"flights-{name}"))
    except SettingsError as error:
        return {"helix": {"ended": "refused", "why": error.found}}
