"""Coverage of 95 % intervals: known effects in noisy recordings, fitted in the right structure, repeatedly.

    .venv/bin/python pipelines/interval_coverage.py [--repeats 40] [--only backlash] [--workers 2]

Commands are those of the test bench's operator and programs, and the response is that of the plant with the effect, so that
the true parameters are known exactly. Sensors add noise, and a disturbance acts on the flow: a random walk, as the drift model
of the fit assumes it, or slower fluctuations that it does not assume; some sensor noise is coloured. No structure is searched:
the right effects are fitted, with the nuisances of every fit. Every repeat has other commands, noise and disturbance. The
intervals are compared with a plain block sandwich estimate. Writes the tables of ``reports/interval_coverage/README.md`` and
``reports/interval_coverage/result.json``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import stats
from scipy.signal import lfilter

from agreement.machines import STREAMS, description, recipe_of, record
from committed import markdown, provenance, write_result, write_tables
from sysid.datasets import Recording
from sysid.effects.effect import Stage
from sysid.gap.candidates import Candidate, Scales, candidates_at
from sysid.gap.data import Data
from sysid.gap.drift import BIN
from sysid.gap.fit import Fit, fit_candidates, jacobian
from sysid.gap.intervals import known_of
from sysid.gap.prepare.noise import problem_floor
from sysid.gap.problem import Problem, drive_problem, force_problem, joint_problem, tip_problem, tool_problem
from sysid.machine import KnownEffect
from sysid.plant import Model, Plant, compile_plant, free_run, nominal_plant
from sysid.plant.force import force_inputs
from sysid.signals import point_signals

Array = npt.NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[1]
REPORT = ROOT / "reports" / "interval_coverage"
PAGE, RESULT = REPORT / "README.md", REPORT / "result.json"
SEED = 20250311
PIPELINE = "pipelines/interval_coverage.py"
RECORDINGS, SECONDS, SLIDE_SECONDS = 3, 40.0, 12.0

#: Standard deviation of each kind of sensor: draw wires [m], joints and points seen by cameras [rad, m], the slide [m, N].
NOISE = {
    "boom.cylinder": 2e-5, "stick.cylinder": 2e-5, "telescope.joint": 2e-5, "slew.joint": 5e-4, "boom.joint": 1e-3,
    "stick.joint": 1e-3, **dict.fromkeys(point_signals("ee"), 6e-4), **dict.fromkeys(point_signals("tool"), 6e-4),
    "carriage.joint": 1e-6, "carriage.command": 0.5,
}  # fmt: skip
#: What the simulation knows of the crane.
KNOWN = tuple(
    KnownEffect(name, axis, dict(values))
    for axis in ("slew", "boom", "stick", "telescope")
    for name, values in (
        ("first_order_lag", {"time_constant": 0.05}),
        ("input_delay", {"delay": 0.03}),
        ("valve_deadband", {"positive": 0.06, "negative": 0.08}),
    )
    if (name, axis) != ("valve_deadband", "stick")
)


@dataclass(frozen=True)
class Disturbed:
    """Disturbance: relative flow fluctuation (standard deviation, correlation time [s]; 0 is white noise with the spectral
    density of 1 s at low frequencies) and the share of sensor noise (in variance) that is coloured, with 0.3 s."""

    name: str
    flow: float = 0.0
    seconds: float = 0.0
    coloured: float = 0.0


MOVING = (
    Disturbed("sensor noise only"),
    Disturbed("flow 0.3 %, random walk", 0.003),
    Disturbed("flow 1 %, 1 s", 0.01, 1.0),
    Disturbed("flow 0.3 %, 10 s", 0.003, 10.0),
)
STILL = (Disturbed("sensor noise only"), Disturbed("half of the noise coloured", coloured=0.5))


@dataclass(frozen=True)
class Family:
    """An effect with its true parameters, where it shows, and what is recorded.

    Args:
        also: other effects of the stage that are fitted with it, at their true values in ``truth``.
    """

    stage: Stage
    effect: KnownEffect
    programs: tuple[str, ...] = ("operator", "steps", "stairs")
    also: tuple[KnownEffect, ...] = ()

    @property
    def label(self) -> str:
        side = f", {self.effect.side}" if self.effect.side else ""
        values = ", ".join(f"{key} {value}" for key, value in self.effect.parameters.items())
        return f"`{self.effect.name}` on {self.effect.target}{side}: {values}"

    @property
    def disturbed(self) -> tuple[Disturbed, ...]:
        return MOVING if self.stage == "command" else STILL


REVERSALS = ("reversals", "operator", "reversals")
FAMILIES = (
    Family("command", KnownEffect("valve_deadband", "boom", {"positive": 0.11, "negative": 0.13})),
    Family("command", KnownEffect("valve_deadband", "stick", {"positive": 0.006, "negative": 0.0})),
    Family("command", KnownEffect("input_delay", "boom", {"delay": 0.083})),
    Family("command", KnownEffect("first_order_lag", "boom", {"time_constant": 0.12})),
    Family("command", KnownEffect("valve_hysteresis", "boom", {"width": 0.05}), REVERSALS),
    Family("command", KnownEffect("gain_curve", "boom", {"exponent": 1.4})),
    Family("command", KnownEffect("flow_saturation", "boom", {"limit": 0.6})),
    Family("command", KnownEffect("stiction", "boom", {"breakaway": 0.2, "release": 0.1})),
    Family("command", KnownEffect("backlash", "slew", {"width": 0.012}, "drive"), REVERSALS),
    Family("joint", KnownEffect("backlash", "boom", {"width": 0.01}, "drive"), REVERSALS),
    Family("joint", KnownEffect("backlash", "boom", {"width": 0.003}, "drive"), REVERSALS),
    Family("end_effector", KnownEffect("backlash", "slew", {"width": 0.012}, "structure"), REVERSALS),
    Family("end_effector", KnownEffect("joint_offset", "stick", {"offset": 0.01})),
    Family("end_effector", KnownEffect("link_length_error", "boom", {"error": 0.003})),
    Family("tool", KnownEffect("gripper_sway", "tool", {"length": 0.22, "damping_ratio": 0.04})),
    Family("force", KnownEffect("coulomb_friction", "carriage", {"force": 20.0}), ("operator",)),
    Family("force", KnownEffect("viscous_friction", "carriage", {"coefficient": 300.0}), ("operator",)),
)  # fmt: skip

# ---- Recordings with a known truth ---------------------------------------------------------------------------------------


def plants(family: Family) -> tuple[Plant, Plant]:
    """Nominal plant and true plant."""
    if family.stage == "force":
        slide = nominal_plant(description(recipe_of("slide", {}))).with_effect(
            KnownEffect("viscous_friction", "carriage", {"coefficient": 200.0})
        )
        return slide, slide.with_effect(family.effect)
    known = nominal_plant(description(recipe_of("valve crane", {})), streams=STREAMS)
    for effect in KNOWN:
        known = known.with_effect(effect)
    return known, known.with_effect(family.effect)


def recordings_of(family: Family, disturbed: Disturbed, seed: int) -> list[Recording]:
    """What is measured, a few recordings."""
    rng = np.random.default_rng([SEED, seed])
    made = []
    for k in range(RECORDINGS):
        program = family.programs[k % len(family.programs)]
        begin = int(rng.integers(1 << 30))
        if family.stage == "force":
            motion = record(recipe_of("slide", {"coulomb": 20.0}), program, begin, SLIDE_SECONDS)
            true = pushed(plants(family)[1], motion)
        else:
            commands = record(recipe_of("valve crane", {}), program, begin, SECONDS)
            true = answered(compile_plant(plants(family)[1]), commands, disturbed, rng)
        made.append(replace(sensed(true, family, disturbed, rng), name=f"take-{k + 1}"))
    return made


def answered(model: Model, commands: Recording, disturbed: Disturbed, rng: np.random.Generator) -> Recording:
    """The machine's response to commands, each stage driven by the true output of the stage before."""
    run = free_run(model, commands)
    theta, machine = model.theta[None], model.machine
    table = commands.table.assign(**{str(s): run[s].to_numpy() for s in run.columns if s in commands.signals})
    for axis in machine.axes:
        moved = np.diff(table[axis.driven].to_numpy())
        flow = 1.0 + fluctuation(disturbed, len(moved), 1.0 / commands.rate_hz, rng)
        table[axis.driven] = table[axis.driven].iloc[0] + np.concatenate([[0.0], np.cumsum(moved * flow)])
    for axis in machine.axes:
        if axis.name in model.linked:
            table[f"{axis.name}.joint"] = model.joint(theta, replace(commands, table=table), axis.name)[0]
    table[list(point_signals("ee"))] = model.tip(theta, replace(commands, table=table))[0]
    table[list(point_signals("tool"))] = model.tool(theta, replace(commands, table=table))[0]
    return replace(commands, table=table)


def pushed(plant: Plant, motion: Recording) -> Recording:
    """The slide's motion with the force that it takes."""
    inputs = force_inputs(motion, plant.machine.axis("carriage"))
    force = plant.machine.axis("carriage").inertia * inputs.acceleration
    for effect, shape in (("viscous_friction", inputs.speed), ("coulomb_friction", np.sign(inputs.speed))):
        found = plant.effect(effect, "carriage")
        if found is not None:
            force += float(next(iter(found.parameters.values()))) * shape  # type: ignore[arg-type]
    return replace(motion, table=motion.table.assign(**{"carriage.command": force}))


def fluctuation(disturbed: Disturbed, count: int, dt: float, rng: np.random.Generator) -> Array:
    """Relative flow, first-order coloured noise."""
    if disturbed.seconds == 0.0:
        return disturbed.flow * np.sqrt(2.0 / dt) * rng.standard_normal(count)
    return disturbed.flow * coloured(count, disturbed.seconds / dt, rng)


def coloured(count: int, samples: float, rng: np.random.Generator) -> Array:
    """First-order noise of variance 1 with a correlation time in samples."""
    decay = np.exp(-1.0 / samples)
    white = rng.standard_normal(count) * np.sqrt(1.0 - decay**2)
    white[0] /= np.sqrt(1.0 - decay**2)
    return np.asarray(lfilter([1.0], [1.0, -decay], white))


def sensed(true: Recording, family: Family, disturbed: Disturbed, rng: np.random.Generator) -> Recording:
    """Readings of the sensors; noise is added before quantisation."""
    table = true.table.copy()
    for signal in true.signals:
        if signal in NOISE:
            noise = np.sqrt(1.0 - disturbed.coloured) * rng.standard_normal(len(table))
            noise += np.sqrt(disturbed.coloured) * coloured(len(table), 0.3 * true.rate_hz, rng)
            said = true.values(signal) + NOISE[signal] * noise
            step = float(family.effect.parameters["step"]) if family.effect.target == signal else 0.0  # type: ignore[arg-type]
            table[signal] = step * np.round(said / step) if step else said
    return replace(true, table=table)


# ---- One repeat ----------------------------------------------------------------------------------------------------------


def problem_of(family: Family, model: Model, recordings: Sequence[Recording]) -> Problem:
    machine, target = model.machine, family.effect.target.partition(".")[0]
    if family.stage == "end_effector":
        return tip_problem(model)
    if family.stage == "tool":
        return tool_problem(model)
    axis = machine.axis(target)
    if family.stage == "force":
        return force_problem(model, axis, recordings)
    return drive_problem(model, axis) if family.stage == "command" else joint_problem(model, axis)


def candidates_of(family: Family, plant: Plant, problem: Problem, names: Sequence[str], target: str) -> list[Candidate]:
    """The effect in the form of its true parameters, then the effects ``names`` of ``target`` that are fitted with it."""
    effect = family.effect
    every = candidates_at(plant, plant.vector(), problem.stage, problem.targets, Scales(20.0, {"boom": 40.0}))
    key = effect.name, effect.target, effect.side
    found = {c.key: c for c in every if c.key == key and set(c.form.names) == set(effect.parameters)}
    for c in every:
        if c.effect.name in names and c.target == target:
            found.setdefault(c.key, c)
    return list(found.values())


def nuisances(problem: Problem) -> tuple[str, ...]:
    """Effects whose parameters are free in every fit of a stage, since others would absorb them otherwise."""
    if problem.stage != "command":
        return ()
    return ("gain_error", "input_delay") if problem.kind.integrates else ("input_delay",)


@dataclass(frozen=True)
class Estimate:
    """One parameter of one repeat; ``plain``: value and ends of the fit as it is with a block sandwich."""

    family: str
    disturbed: str
    parameter: str
    true: float
    value: float
    low: float
    high: float
    plain: tuple[float, float, float]
    seconds: float


def repeat(family: Family, disturbed: Disturbed, seed: int) -> list[Estimate]:
    """Record, fit, and compute the intervals of the effect's parameters."""
    recordings = recordings_of(family, disturbed, seed)
    data, theta, fit = fitted(family, recordings, seed)
    plain = block_sandwich(data, theta, fit)
    begin = time.process_time()
    known = known_of(data, theta, fit, NOISE, seed)
    seconds = time.process_time() - begin
    found = []
    for k, true in enumerate(family.effect.parameters.values()):
        value, (low, high), key = known.fit.values[k], known.limits[k], fit.unknowns[k].key
        old = float(fit.values[k]), float(plain[k, 0]), float(plain[k, 1])
        row = family.label, disturbed.name, key, float(true), float(value), float(low), float(high), old, seconds  # type: ignore[arg-type]
        found.append(Estimate(*row))
    return found


def fitted(family: Family, recordings: Sequence[Recording], seed: int) -> tuple[Data, Array, Fit]:
    known, truth = plants(family)
    model = compile_plant(known)
    problem = problem_of(family, model, recordings)
    sigma = problem_floor(problem, truth.vector(), recordings, NOISE, seed)
    data = Data(problem, recordings, sigma)
    candidates = candidates_of(family, known, problem, nuisances(problem), problem.target)
    true = [float(v) for v in family.effect.parameters.values()]  # type: ignore[arg-type]
    unknowns = [u for c in candidates for u in c.unknowns]
    start = np.array([*true, *(u.nominal for u in unknowns[len(true) :])])
    return data, model.theta, fit_candidates(data, model.theta, candidates, [start])


def block_sandwich(data: Data, theta: Array, fit: Fit, seconds: float = 4.0) -> Array:
    """Interval ends (k, 2) by the textbook's block sandwich, for comparison."""
    blocks, bread = [], np.zeros((len(fit.unknowns), len(fit.unknowns)))
    for recording in data.recordings:
        own = replace(data, recordings=[recording])
        r, slopes = own.errors(fit.theta[None])[0], jacobian(own.errors, theta, fit.unknowns, fit.values)
        bread += slopes.T @ slopes
        blocks.append(np.add.reduceat(slopes * r[:, None], np.arange(0, len(r), round(seconds / BIN)), axis=0))
    score, inverse = np.concatenate(blocks), np.linalg.pinv(bread, rcond=1e-12)
    free = max(len(score) - len(fit.unknowns), 1)
    covariance = inverse @ (score.T @ score) @ inverse * len(score) / free
    reach = stats.t.ppf(0.975, free) * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    bounds = np.array([u.bounds for u in fit.unknowns])
    return np.clip(fit.values[:, None] + reach[:, None] * [-1.0, 1.0], bounds[:, :1], bounds[:, 1:])


# ---- The page ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """A parameter over its repeats.

    Args:
        covers, plain_covers: share of the intervals that hold the truth.
        error, plain_error: median |value − truth| [unit].
        width: median half width of the intervals in 1.96 root-mean-square errors of what is disturbed alike.
    """

    family: str
    parameter: str
    repeats: int
    covers: float
    plain_covers: float
    error: float
    plain_error: float
    half: float
    width: float
    seconds: float


def row_of(found: Sequence[Estimate]) -> Row:
    errors = np.array([e.value - e.true for e in found])
    kinds = np.array([e.disturbed for e in found])
    halves = np.array([0.5 * (e.high - e.low) for e in found])
    scale = np.array([np.sqrt(np.mean(errors[kinds == kind] ** 2)) for kind in kinds])
    return Row(
        found[0].family,
        found[0].parameter,
        len(found),
        float(np.mean([e.low <= e.true <= e.high for e in found])),
        float(np.mean([e.plain[1] <= e.true <= e.plain[2] for e in found])),
        float(np.median(np.abs(errors))),
        float(np.median([abs(e.plain[0] - e.true) for e in found])),
        float(np.median(halves)),
        float(np.median(halves / (1.96 * np.maximum(scale, 1e-12)))),
        float(np.median([e.seconds for e in found])),
    )


def table(rows: Sequence[Row], found: Sequence[Estimate]) -> str:
    head = [
        "effect", "parameter", "repeats", "interval covers", "plain sandwich covers", "median error, that of the plain fit",
        "half width, median", "in 1.96 rms errors", "seconds",
    ]  # fmt: skip
    lines = [
        (
            r.family, r.parameter, str(r.repeats), f"{r.covers:.0%}", f"{r.plain_covers:.0%}",
            f"{r.error:.2g}, {r.plain_error:.2g}", f"{r.half:.2g}", f"{r.width:.2f}", f"{r.seconds:.2f}",
        )
        for r in rows
    ]  # fmt: skip
    totals = []
    for name in [*dict.fromkeys(e.disturbed for e in found), "all"]:
        part = [e for e in found if name in (e.disturbed, "all")]
        hits = sum(e.low <= e.true <= e.high for e in part)
        plain = sum(e.plain[1] <= e.true <= e.plain[2] for e in part) / len(part)
        low, high = stats.binomtest(hits, len(part)).proportion_ci(0.95, "wilson")
        totals.append((name, str(len(part)), f"{hits / len(part):.1%}", f"{low:.1%} – {high:.1%}", f"{plain:.1%}"))
    by_disturbance = markdown(("disturbed by", "intervals", "cover", "Wilson 95 %", "plain sandwich"), totals)
    return f"{markdown(head, lines, 'll')}\n\n{by_disturbance}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=40)
    parser.add_argument("--only", default="", help="part of a family's label; nothing is written then")
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    families = [family for family in FAMILIES if args.only in family.label]
    jobs = [(f, f.disturbed[k % len(f.disturbed)], k) for f in families for k in range(args.repeats)]
    with ProcessPoolExecutor(args.workers) as pool:
        found = [e for part in pool.map(repeat, *zip(*jobs, strict=True), chunksize=4) for e in part]
    keys = dict.fromkeys((e.family, e.parameter) for e in found)
    rows = [row_of([e for e in found if (e.family, e.parameter) == key]) for key in keys]
    text = table(rows, found)
    print(text)
    if args.only:
        return
    command = f"python {PIPELINE} --repeats {args.repeats}"
    write_result(RESULT, provenance(command, SEED) | {"rows": [asdict(row) for row in rows]})
    write_tables(PAGE, text, PIPELINE)


if __name__ == "__main__":
    main()
