"""Structure that no known effect explains: where it is, on what it depends, in which form. Never a name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.drift import to_bins
from sysid.gap.fit import Fit
from sysid.gap.problem import Problem
from sysid.gap.result import Unnamed
from sysid.machine import Machine
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Width of the bins in which a residual is compared with probes [s].
BIN = 0.2
#: Least correlation that counts as a dependence.
LEAST = 0.25


def describe_remainder(problem: Problem, fit: Fit, recordings: Sequence[Recording], machine: Machine) -> list[Unnamed]:
    """The worst signal of the stage: the probe that its residual follows best, and a linear form in it.

    The residual of a stage that integrates its command is compared as a rate (its change over a bin), since an error of speed
    shows there at once.
    """
    found = []
    for k, signal in enumerate(problem.signals):
        probes: dict[str, list[Array]] = {}
        targets = []
        total = []
        for recording in recordings:
            if recording.kind != "motion":
                continue
            rate_hz = problem.rate(recording)
            r = (problem.measured(recording) - problem.predict(fit.theta[None], recording)[0])[:, k : k + 1]
            total.append(r[:, 0])
            series = to_bins(r, rate_hz, BIN)[:, 0]
            rate = problem.integrates
            targets.append(np.diff(series) / BIN if rate else series[1:])
            for name, values in _probes(recording, machine).items():
                at_rows = values[problem.rows(recording), None]
                probes.setdefault(name, []).append(to_bins(at_rows, rate_hz, BIN)[1:, 0])
        if not targets:
            continue
        name, correlation, slope = _best(np.concatenate(targets), {n: np.concatenate(p) for n, p in probes.items()})
        joined = np.concatenate(total)
        rmse = float(np.sqrt(np.nanmean(joined**2)))
        what = "rate of the residual" if problem.integrates else "residual"
        if abs(correlation) < LEAST:
            name, form = "nothing that was measured", f"{what}: no linear dependence above |ρ| = {LEAST} on any probe"
            if problem.integrates:
                share = _share_of_speed(np.concatenate(targets), np.concatenate(probes[f"speed of {problem.target}"]))
                form += f"; it looks like a random disturbance of about {100.0 * share:.1f} % of the speed"
        else:
            form = f"{what} of {signal} ≈ {slope:.3g} · {name} (ρ = {correlation:.2f})"
        found.append(Unnamed(problem.stage, problem.target, rmse, name, form))
    return sorted(found, key=lambda u: -u.rmse)[:1]


def _probes(recording: Recording, machine: Machine) -> dict[str, Array]:
    probes = {"time": recording.values("time")}
    dt = 1.0 / recording.rate_hz
    for axis in machine.axes:
        u = recording.values(axis_signal(axis.name, "command"))
        if not np.isnan(u).all():
            probes[f"{axis.name}.command"] = u
            probes[f"|{axis.name}.command|"] = np.abs(u)
            probes[f"sign({axis.name}.command)"] = np.sign(u)
        x = recording.values(axis.driven)
        if not np.isnan(x).all():
            probes[axis.driven] = x
            speed = np.gradient(x, dt)
            probes[f"speed of {axis.name}"] = speed
            probes[f"sign(speed of {axis.name})"] = np.sign(
                np.where(np.abs(speed) > 0.02 * np.nanmax(np.abs(speed)), speed, 0.0)
            )
    return probes


def _share_of_speed(rate: Array, speed: Array) -> float:
    """RMS of the residual's rate over RMS of the speed, while moving."""
    there = ~np.isnan(rate) & ~np.isnan(speed)
    moving = there & (np.abs(speed) > 0.1 * np.nanmax(np.abs(speed)))
    return float(np.sqrt(np.mean(rate[moving] ** 2) / np.mean(speed[moving] ** 2))) if moving.any() else 0.0


def _best(target: Array, probes: dict[str, Array]) -> tuple[str, float, float]:
    """(probe, correlation, slope) with the largest absolute correlation."""
    best = ("", 0.0, 0.0)
    for name, probe in probes.items():
        there = ~np.isnan(target) & ~np.isnan(probe)
        if there.sum() < 20:
            continue
        x, y = probe[there] - probe[there].mean(), target[there] - target[there].mean()
        power = float(x @ x) * float(y @ y)
        if power <= 0.0:
            continue
        correlation = float(x @ y) / float(np.sqrt(power))
        if abs(correlation) > abs(best[1]):
            best = (name, correlation, float(x @ y) / float(x @ x))
    return best
