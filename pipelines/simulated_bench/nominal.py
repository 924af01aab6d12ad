"""Fits of the named effects to noise-free runs of the simulated test bench: nominal plant of the owner, and hidden effects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares, minimize

from simulated_bench.circuit import lever
from simulated_bench.compiled import compiled
from simulated_bench.contract_chain import KEYS, PARAMETERS, neutral_row, share_pump, speeds, travel
from simulated_bench.cylinder import drive_of, position_of
from simulated_bench.machine import Truth, run_machine
from simulated_bench.recipe import AXES, BenchRecipe, HiddenSettings, RecordingSettings
from simulated_bench.rigid_body import RigidBodies, bodies_of, equations

Array = npt.NDArray[np.float64]

#: Effects of the nominal plant of a valve, and of a hydraulic drive.
BASIC = ("input_delay", "valve_deadband", "first_order_lag", "gain_error")
HYDRAULIC = (*BASIC, "asymmetric_gain", "load_dependent_flow")
#: Runs for the fit of hidden effects, beside those of the case.
STEP_TESTS = (
    RecordingSettings("steps", seed=9001, seconds=60.0, program="steps"),
    RecordingSettings("stairs", seed=9002, seconds=60.0, program="stairs"),
    RecordingSettings("hand", seed=9003, seconds=60.0),
)
#: Runs for the fit of the nominal plant: twelve minutes of all kinds of motion. Without the slow closed-loop runs the overlap
#: has an error of up to 0.003.
FLOWN = RecordingSettings("flight", seed=9004, seconds=60.0, program="flight")
OWNERS_TESTS = tuple(replace(test, seed=test.seed + 10 * k) for k in range(1, 4) for test in (*STEP_TESTS, FLOWN))
#: Seed of the owner's tests, whatever is recorded afterwards.
OWNERS_SEED = 1
#: Steps between two residuals; positions hardly change in between.
STRIDE = 10
#: Displacements over this time [s] are compared. Over whole runs the small errors of a simplified valve accumulate to a drift,
#: with an error of the overlap of up to 0.01.
SPAN = 0.2


@dataclass(frozen=True)
class CommandChain:
    """The command stage of all axes: ``rows`` (axes, parameters), ``gains`` (axes,) [m/s or rad/s], and the pump's limit."""

    rows: Array
    gains: Array
    pump: float = np.inf

    def value(self, axis: str, effect: str, parameter: str) -> float:
        return float(self.rows[AXES.index(axis), KEYS.index((effect, parameter))])


def noise_free(recipe: BenchRecipe, recordings: Sequence[RecordingSettings]) -> tuple[Truth, ...]:
    """True motion in ``recordings`` without flow disturbance."""
    axes = {name: replace(axis, valve=replace(axis.valve, disturbance=0.0)) for name, axis in recipe.axes.items()}
    undisturbed = replace(recipe, axes=axes)
    return tuple(run_machine(undisturbed, each, np.random.default_rng([recipe.seed, each.seed, 0])) for each in recordings)


def loads(recipe: BenchRecipe, truth: Truth) -> Array:
    """Gravity moment or force against positive motion of each drive at the joints of a run, (axes, n), from the drawing.

    The drawing has the masses, but no springs that compensate them.
    """
    bodies = bodies_of(replace(recipe.masses, balanced=0.0), recipe.geometry.boom, recipe.geometry.stick, recipe.gripper.length)
    found = np.zeros((len(AXES), len(truth.time)))
    coarse = truth.joint[::STRIDE]
    moments = gravity_along(coarse, bodies)
    at = np.arange(len(truth.time))
    for i, name in enumerate(AXES[1:], start=1):
        drive = drive_of(recipe.axis(name))
        park = recipe.axis(name).park
        sense = np.sign(lever(park, position_of(park, drive), drive))
        found[i] = sense * np.interp(at, at[::STRIDE], moments[:, i - 1])
    return found


@compiled
def gravity_along(joints: Array, bodies: RigidBodies) -> Array:
    """About boom, stick [N·m] and along the telescope [N] at every row of ``joints`` (n, 4), (n, 3)."""
    mass, bias, rest = np.empty((3, 3)), np.empty(3), np.zeros(4)
    weight = np.empty((len(joints), 3))
    for k in range(len(joints)):
        equations(joints[k], rest, bodies, mass, bias, weight[k])
    return weight


def predict(recipe: BenchRecipe, chain: CommandChain, truth: Truth, load: Array, columns: Sequence[int]) -> Array:
    """Drive positions (n, columns) of a free run of the chain from the commands of ``truth``."""
    step = float(truth.time[1] - truth.time[0])
    gains = chain.gains
    rates = np.empty((len(AXES), len(truth.time)))
    shared = bool(np.isfinite(chain.pump))
    for i in range(len(AXES)) if shared else columns:
        speeds(np.ascontiguousarray(truth.command[:, i]), load[i], chain.rows[i], gains[i], step, rates[i])
    if shared:
        share_pump(rates, gains, chain.pump)
    out = np.empty((len(columns), len(truth.time)))
    for row, i in zip(out, columns, strict=True):
        drive = drive_of(recipe.axis(AXES[i]))
        travel(rates[i], float(truth.drive[0, i]), drive.low, drive.high, step, row)
    return np.asarray(out.T)


def fit_nominal(recipe: BenchRecipe) -> CommandChain:
    """Gain, delay, lag, overlap of every axis (sides and load of hydraulic ones) from the owner's tests of ``recipe``."""
    runs = noise_free(replace(recipe, seed=OWNERS_SEED), OWNERS_TESTS)
    gains = np.array([recipe.axis(name).valve.gain for name in AXES])
    chain = CommandChain(np.array([_data_sheet(recipe, name) for name in AXES]), gains)
    for name in AXES:
        effects: tuple[str, ...] = HYDRAULIC if recipe.axis(name).drive == "hydraulic" else BASIC
        if name == "slew" or recipe.masses.balanced == 1.0:  # no weight acts on the drive: not identifiable
            effects = tuple(effect for effect in effects if effect != "load_dependent_flow")
        chain = fit_effects(recipe, chain, [HiddenSettings(effect, name) for effect in effects], runs)
    rows = chain.rows.copy()
    ratio = KEYS.index(("gain_error", "ratio"))
    gains = chain.gains * rows[:, ratio]
    rows[:, ratio] = 1.0
    return CommandChain(rows, gains)


def _data_sheet(recipe: BenchRecipe, axis: str) -> Array:
    """A row with the values of the valve's data sheet: start of the fit."""
    valve = recipe.axis(axis).valve
    row = neutral_row()
    row[KEYS.index(("input_delay", "delay"))] = valve.delay
    row[KEYS.index(("first_order_lag", "time_constant"))] = valve.time_constant
    row[KEYS.index(("valve_deadband", "positive"))] = valve.deadband_positive
    row[KEYS.index(("valve_deadband", "negative"))] = valve.deadband_negative
    return row


def fit_effects(
    recipe: BenchRecipe, chain: CommandChain, effects: Sequence[HiddenSettings], runs: Sequence[Truth]
) -> CommandChain:
    """The chain whose named command-stage ``effects`` fit ``runs`` best, all other parameters as they are in ``chain``."""
    places = [(AXES.index(e.target), k) for e in effects if e.target in AXES for k, key in enumerate(KEYS) if key[0] == e.name]
    pump = any(e.name == "pump_flow_limit" for e in effects)
    if not places and not pump:
        return chain
    lows = np.array([PARAMETERS[KEYS[k]][1] for _, k in places] + [0.1] * pump)
    highs = np.array([PARAMETERS[KEYS[k]][2] for _, k in places] + [4.0] * pump)
    scales = np.array([PARAMETERS[KEYS[k]][3] for _, k in places] + [1.0] * pump)
    load = [loads(recipe, run) for run in runs]
    columns = sorted({i for i, _ in places}) if not pump else list(range(len(AXES)))
    spans = np.array([drive_of(recipe.axis(name)).high - drive_of(recipe.axis(name)).low for name in AXES])

    def with_values(values: Array) -> CommandChain:
        rows = chain.rows.copy()
        for (i, k), value in zip(places, values, strict=False):
            rows[i, k] = value
        return CommandChain(rows, chain.gains, float(values[-1]) if pump else chain.pump)

    def residuals(scaled: Array) -> Array:
        tried = with_values(np.clip(scaled * scales, lows, highs))
        parts = []
        for run, moment in zip(runs, load, strict=True):
            left = predict(recipe, tried, run, moment, columns)[::STRIDE] - run.drive[::STRIDE, columns]
            lag = round(SPAN / (STRIDE * recipe.step))
            parts.append(((left[lag:] - left[:-lag]) / spans[columns]).ravel())
        return np.concatenate(parts)

    before = np.array([chain.rows[i, k] for i, k in places] + ([min(chain.pump, 4.0)] if pump else []))
    # Starts: the present values and typical sizes; the cost of hysteresis, stiction and limits is flat where they are absent.
    best = None
    starts = [before, scales, 0.4 * scales]
    if len(lows) <= 2:
        # The cost of stiction jumps and that of hysteresis has kinks, so that a gradient does not lead to the minimum.
        starts.insert(0, _grid_search(lambda point: float(np.sum(residuals(point / scales) ** 2)), lows, highs, scales))
    for start in starts:
        if best is not None and best.cost < 1e-9 * len(best.fun):
            break
        inside = np.clip(start, lows + 1e-6 * (highs - lows), highs - 1e-6 * (highs - lows)) / scales
        found = least_squares(
            residuals,
            inside,
            bounds=(lows / scales, highs / scales),
            diff_step=np.full(len(lows), 1e-3),
            ftol=1e-3,
            max_nfev=20,
        )
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    # Delay and lag are strongly correlated, which needs fine differences.
    closer = least_squares(
        residuals,
        best.x,
        bounds=(lows / scales, highs / scales),
        diff_step=np.full(len(lows), 1e-5),
        xtol=1e-12,
        ftol=1e-10,
        gtol=1e-15,
        max_nfev=40,
    )
    best = closer if closer.cost < best.cost else best
    values: Array = np.asarray(best.x, dtype=np.float64)
    if len(values) <= 3:
        # Hysteresis and limits have kinks: finish without derivatives.
        def cost(scaled: Array) -> float:
            return float(np.sum(residuals(scaled) ** 2))

        refined = minimize(cost, values, method="Nelder-Mead", options={"maxiter": 60, "xatol": 1e-5})
        values = np.asarray(refined.x) if cost(refined.x) < cost(values) else values
    return with_values(np.clip(values * scales, lows, highs))


def _grid_search(cost: Callable[[Array], float], lows: Array, highs: Array, scales: Array) -> Array:
    """The best point of a grid that is refined twice around the best so far."""
    centre, half = lows + 3.0 * scales, 3.0 * scales
    for _ in range(3):
        ends = zip(np.maximum(lows, centre - half), np.minimum(highs, centre + half), strict=True)
        grid = np.stack(np.meshgrid(*(np.linspace(*pair, 11) for pair in ends)), axis=-1).reshape(-1, len(lows))
        centre = grid[int(np.argmin([cost(point) for point in grid]))]
        half = 0.2 * half
    return np.asarray(centre)


def model_error(recipe: BenchRecipe, chain: CommandChain, runs: Sequence[Truth]) -> dict[str, float]:
    """RMSE of the chain's free runs against what happened, per drive signal [m or rad]."""
    squares = np.zeros(len(AXES))
    count = 0
    for run in runs:
        left = predict(recipe, chain, run, loads(recipe, run), range(len(AXES))) - run.drive
        squares += np.sum(left**2, axis=0)
        count += len(left)
    return {recipe.drive_signal(name): float(np.sqrt(squares[i] / count)) for i, name in enumerate(AXES)}
