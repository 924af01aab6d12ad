"""The models that are compared: plants with and without a residual network, and networks alone, each as a free run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import expit

from pays.machines import WARM_UP, Source, evaluated_rows, in_blocks, leading, pieces
from sysid.datasets import Dataset, Recording, Role
from sysid.datasets.chunked import stretches
from sysid.errors import ExcitationError, SettingsError
from sysid.gap import steps
from sysid.networks import MotionNetwork, fit_motion, parse_recipe
from sysid.networks.cell import REACH
from sysid.networks.motion import bounds_of
from sysid.networks.motion_inputs import Window
from sysid.networks.recurrent import RecordingWindow, RecurrentSettings, interval_means, train_recurrent
from sysid.plant import Plant, free_run, nominal_plant

Array = npt.NDArray[np.float64]
#: Recording → the predicted motion on its rows (n,), without a look at the measurement but for its start.
Predict = Callable[[Recording], Array]
#: Errors by the kind of run [SI].
Errors = dict[str, float]
SEEDS = (0, 1, 2)
#: Roles of the blocks of each recording, for every model.
BLOCKS: tuple[tuple[Role, float], ...] = (("fit", 0.7), ("select", 0.3))
#: Time between two updates of the recurrent network [s], rounded to whole samples, and its training: that of residual networks.
INTERVAL = 0.05
RECURRENT = RecurrentSettings()
#: Bound of the recurrent network: this factor of its largest target.
BOUND = 1.2
DESCRIBED, FOUND, RESIDUAL = "machine as described", "with effects of sysid gap", "and residual network"
MOTION_NETWORK, RECURRENT_NETWORK = "motion network alone", "recurrent network alone"


def errors(predict: Predict, source: Source) -> Errors:
    """RMSE of free runs over whole test recordings and over pieces of them, on the evaluated rows [SI]."""
    return {"whole": _rmse(predict, source, source.test), "pieces": _rmse(predict, source, pieces(source.test))}


def _rmse(predict: Predict, source: Source, recordings: Sequence[Recording]) -> float:
    squares = []
    for recording in recordings:
        rows = evaluated_rows(recording, source.command, source.signal)
        squares.append((predict(recording) - recording.values(source.signal))[rows] ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def plant_rows(source: Source, seconds: float, seeds: Sequence[int] = SEEDS) -> dict[str, Any]:
    """Errors of the described plant, of that with named effects, and of that with a residual network of each seed.

    The workflow fits and selects on the leading ``seconds`` and proves on the held-out recordings, where a name or a network
    may only be withdrawn. Where it refuses to work, the plant stays as described.
    """
    described = nominal_plant(source.machine)
    found: dict[str, Any] = {DESCRIBED: errors(_run(described, source), source)}
    data = in_blocks(source.machine, leading(source.training, seconds), BLOCKS)
    roles = {**data.splits, **dict.fromkeys((r.name for r in source.held_out), "held_out")}
    data = Dataset.of(source.machine, (*data.recordings, *source.held_out), roles)  # type: ignore[arg-type]
    try:
        study = steps.search(steps.open_study(data, described))
        outcome = steps.decide_on(study)
    except ExcitationError as refused:
        return found | {FOUND: None, RESIDUAL: [], "refused": str(refused)}
    found[FOUND] = errors(_run(outcome.repaired, source), source)
    found["effects"] = [{"name": e.name, "target": e.target, "parameters": dict(e.parameters)} for e in outcome.named]
    found["written"] = [e.name for e in outcome.repaired.effects if e not in described.effects]
    found["unnamed"] = [item.stage for item in outcome.unnamed]
    found[RESIDUAL], found["networks"] = [], []
    for seed in seeds if outcome.unnamed else ():
        seeded = replace(study, case=replace(study.case, seed=seed))
        extended = steps.with_residual_networks(seeded, outcome)
        found[RESIDUAL].append(errors(_run(extended.repaired, source), source))
        found["networks"].append([{"accepted": item.accepted, "text": item.text} for item in extended.carried])
    tested = replace(study, case=replace(study.case, split=replace(study.case.split, held_out=source.test)))
    found["noise_floor"] = steps.measure(tested, outcome).gap.noise_floor[source.signal]
    return found


def _run(plant: Plant, source: Source) -> Predict:
    return lambda recording: free_run(plant, recording)[source.signal].to_numpy()


def motion_row(
    source: Source, seconds: float, recipe: Mapping[str, Any] | None = None, seeds: Sequence[int] = SEEDS
) -> dict[str, Any]:
    """Error of the motion network of each seed, by the default recipe or with the values of ``recipe``.

    None where there is too little data for one.
    """
    data = network_data(source, seconds)
    found = []
    for seed in seeds:
        try:
            network = fit_motion(data, parse_recipe({"seed": seed, "motion": dict(recipe or {})}, "motion network"))[
                source.axis
            ]
        except ExcitationError as refused:
            return {MOTION_NETWORK: [], "refused": str(refused)}
        found.append(errors(started(network), source))
    return {MOTION_NETWORK: found}


def started(network: MotionNetwork) -> Predict:
    """The free run of a motion network, of which each stretch starts from the measurement at the end of the warm-up."""
    window = network.window

    def predict(recording: Recording) -> Array:
        found = np.full(len(recording), np.nan)
        skipped = round(WARM_UP * recording.rate_hz) - window.depth * window.stride(recording.rate_hz)
        if skipped < 0:
            raise SettingsError("motion network", f"a history of {window.depth * window.step:g} s", f"at most {WARM_UP:g} s")
        for start, stop in command_stretches(recording, network.command):
            if stop - start - skipped > 0:
                table = recording.table.iloc[start + skipped : stop].reset_index(drop=True)
                found[start + skipped : stop] = network.free_run(replace(recording, table=table))
        return found

    return predict


def recurrent_row(source: Source, seconds: float, seeds: Sequence[int] = SEEDS) -> dict[str, Any]:
    """Error of the recurrent network of each seed; none where there is too little data for one."""
    data = network_data(source, seconds)
    found = []
    for seed in seeds:
        try:
            network = fit_recurrent(source, data, seed)
        except SettingsError as refused:
            return {RECURRENT_NETWORK: [], "refused": str(refused)}
        found.append(errors(network.free_run, source))
    return {RECURRENT_NETWORK: found}


def network_data(source: Source, seconds: float) -> Dataset:
    return in_blocks(source.machine, leading(source.training, seconds), BLOCKS)


@dataclass(frozen=True)
class RecurrentNetwork:
    """An LSTM of the commands alone: the speed of the axis, or the distance of a position axis from its command.

    Trained by :func:`sysid.networks.recurrent.train_recurrent`, as residual networks are. A free run warms up for
    :data:`WARM_UP` and starts from the measurement there; positions are bounded as those of a motion network.
    """

    command: str
    signal: str
    follows: bool
    weights: Mapping[str, Array]
    bound: float
    limits: tuple[float, float]

    def free_run(self, recording: Recording) -> Array:
        """The motion on the rows of a recording (n,)."""
        measured, found = recording.values(self.signal), np.full(len(recording), np.nan)
        warm = round(WARM_UP * recording.rate_hz)
        for start, stop in command_stretches(recording, self.command):
            commands, stride = updates(recording, self.command, start, stop), samples(recording.rate_hz)
            output = self.outputs(commands)
            if self.follows:
                rows = slice(start, start + stride * len(output))
                found[rows] = np.clip(recording.values(self.command)[rows] + np.repeat(output, stride), *self.limits)
                continue
            first = warm // stride
            if first > len(output):
                continue
            run = [measured[start + first * stride]] if start + first * stride < stop else []
            for speed in output[first:] if run else ():
                run.append(float(np.clip(run[-1] + speed * stride / recording.rate_hz, *self.limits)))
            at = np.arange(start + first * stride, stop)
            if run:
                found[at] = np.interp(at, start + stride * (first + np.arange(len(run))), run)
        return found

    def outputs(self, commands: Array) -> Array:
        """Output of the network at each update (k,)."""
        w = self.weights
        hidden = memory = np.zeros(w["U"].shape[1])
        found = np.empty(len(commands))
        inputs = np.clip((commands[:, None] - w["mean"]) * w["scale"], -REACH, REACH) @ w["W"].T + w["b"]
        for k, driven in enumerate(inputs):
            i, f, g, o = np.split(driven + w["U"] @ hidden, 4)
            memory = expit(f) * memory + expit(i) * np.tanh(g)
            hidden = expit(o) * np.tanh(memory)
            found[k] = self.bound * np.tanh(w["w"] @ hidden + w["w0"][0])
        return found


def fit_recurrent(source: Source, data: Dataset, seed: int) -> RecurrentNetwork:
    """Raises SettingsError where there are too few updates to train on."""
    follows = source.machine.axis(source.axis).actuation == "position"
    fit, select = ([w for r in data.with_role(role) for w in windows(source, r, follows)] for role in ("fit", "select"))
    interval = samples(data.machine.rate_hz) / data.machine.rate_hz
    targets = [w.residual if follows else np.diff(w.residual) / interval for w in fit]
    bound = BOUND * max((float(np.nanmax(np.abs(each))) for each in targets), default=0.0)
    trained = train_recurrent(fit, select, bound, interval, not follows, RECURRENT, seed)
    axis, window = source.machine.axis(source.axis), Window(interval, (0,), (0,))
    limits = bounds_of(data, axis, window, np.array([-bound, bound])).positions
    return RecurrentNetwork(source.command, source.signal, follows, trained.weights, bound, limits)


def windows(source: Source, recording: Recording, follows: bool) -> list[RecordingWindow]:
    """The stretches of a recording with commands, a row for each update."""
    found = []
    for start, stop in command_stretches(recording, source.command):
        commands, stride = updates(recording, source.command, start, stop), samples(recording.rate_hz)
        rows = slice(start, start + stride * len(commands))
        target = recording.values(source.signal)[rows]
        target = interval_means(target - recording.values(source.command)[rows], stride) if follows else target[::stride]
        if len(commands) > 1:
            found.append(RecordingWindow(commands[:, None], target, np.ones(len(commands))))
    return found


def updates(recording: Recording, command: str, start: int, stop: int) -> Array:
    """Mean command from each update to the next (k,)."""
    stride = samples(recording.rate_hz)
    return interval_means(recording.values(command)[start : start + (stop - start) // stride * stride], stride)


def samples(rate_hz: float) -> int:
    """Samples between two updates."""
    return max(1, round(INTERVAL * rate_hz))


def command_stretches(recording: Recording, command: str) -> list[tuple[int, int]]:
    """First and last + 1 row of every stretch without a gap in the command."""
    return [(int(a), int(b)) for a, b in zip(*stretches(np.isfinite(recording.values(command))), strict=True)]
