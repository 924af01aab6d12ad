"""`sysid gap` on MuJoCo models beside mujoco.sysid: parameters, errors of held-out runs, time, and what each can say.

    python pipelines/mujoco_sysid.py --work FOLDER             # all cases
    python pipelines/mujoco_sysid.py --work FOLDER --publish   # result and table of reports/mujoco_sysid

A machine is a MuJoCo model with an error that the model under test lacks. mujoco.sysid fits parameters that its user chooses:
once those that contain the error, and once others that a user may suspect instead. `sysid gap` gets the recordings alone. Both
use the same fit recordings, and every result is an MJCF file whose held-out run is compared with the noise-free truth.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import pandas as pd

from committed import markdown, provenance, write_result, write_tables
from sysid.cli.output import Printer
from sysid.cores import cores
from sysid.datasets import Dataset, Recording
from sysid.datasets.robot_files import Choices, drafted_files
from sysid.errors import SettingsError
from sysid.gap import find_gap
from sysid.gap.adapters.mujoco import open_model, write_model
from sysid.machine import Machine, machine_from_files

ROOT = Path(__file__).resolve().parents[1]
Array = npt.NDArray[np.float64]
Change = Callable[[Any, float], None]
#: Recordings by role, and the standard deviation of the joint sensors [rad].
ROLES = {"run-1": "fit", "run-2": "fit", "run-3": "select", "run-4": "held_out"}
NOISE = 2e-4

SERVO = """<mujoco model="servo"><compiler angle="radian"/><option timestep="0.01" integrator="implicitfast"/>
<worldbody><body name="link"><joint name="hinge" axis="0 0 1" range="-2 2" damping="0.2" armature="0.05"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.5" contype="0" conaffinity="0"/></body></worldbody>
<actuator><position name="hinge" joint="hinge" kp="60" kv="3" ctrlrange="-2 2"/></actuator></mujoco>"""
ARM = """<mujoco model="arm"><compiler angle="radian"/><option timestep="0.001"/>
<default><geom contype="0" conaffinity="0"/></default><worldbody><body name="upper" pos="0 0 1">
<joint name="shoulder" axis="0 1 0" range="-2 2" damping="0.8" frictionloss="0.2" armature="0.05"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03" mass="2"/><body name="lower" pos="0 0 -0.4">
<joint name="elbow" axis="0 1 0" range="-2.2 2.2" damping="0.3" frictionloss="0.1" armature="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.35" size="0.02" mass="1"/></body></body></worldbody>
<actuator><motor name="shoulder" joint="shoulder" ctrlrange="-20 20"/>
<motor name="elbow" joint="elbow" ctrlrange="-10 10"/></actuator></mujoco>"""


@dataclass(frozen=True)
class Number:
    """A parameter that mujoco.sysid may fit: its start value, range, and place in a model."""

    start: float
    low: float
    high: float
    change: Change


@dataclass(frozen=True)
class Case:
    """A model under test and the machine that it lacks something of.

    Args:
        truth: numbers of the machine, which are known to nobody.
        right, other: numbers that a user of mujoco.sysid chooses; without ``other`` only the right ones.
        prepare: what the spec under test needs before the numbers ``right`` exist in it.
        torques: amplitudes of the motors [N·m].
    """

    name: str
    xml: str
    truth: Mapping[str, float]
    right: Mapping[str, Number]
    other: Mapping[str, Number]
    prepare: Callable[[Any], None] = lambda spec: None
    rate_hz: float = 50.0
    seconds: float = 8.0
    torques: tuple[float, ...] = ()


def joint_number(joint: str, attribute: str, start: float, high: float) -> Number:
    def change(spec: Any, value: float) -> None:
        held = getattr(spec.joint(joint), attribute)
        setattr(spec.joint(joint), attribute, value if np.isscalar(held) else np.array([value, *held[1:]]))

    return Number(start, 0.0, high, change)


def mass_of(body: str, start: float) -> Number:
    return Number(start, 0.3 * start, 3.0 * start, lambda spec, value: setattr(spec.body(body).geoms[0], "mass", value))


def with_delay(spec: Any) -> None:
    actuator = spec.actuators[0]
    actuator.delay, actuator.nsample, actuator.interp = 0.001, 12, 1


def with_filter(spec: Any) -> None:
    actuator = spec.actuators[0]
    actuator.dyntype, actuator.dynprm = mujoco.mjtDyn.mjDYN_FILTEREXACT, np.array([0.002, *9 * [0.0]])


DELAY = Number(0.01, 0.0, 0.1, lambda spec, value: setattr(spec.actuators[0], "delay", value))
LAG = Number(0.01, 0.001, 0.3, lambda spec, value: setattr(spec.actuators[0], "dynprm", np.array([value, *9 * [0.0]])))
SUSPECTED = {"damping": joint_number("hinge", "damping", 0.2, 10.0), "armature": joint_number("hinge", "armature", 0.05, 1.0)}
CASES = (
    Case("servo with a dead time", SERVO, {"delay": 0.03}, {"delay": DELAY}, SUSPECTED, with_delay),
    Case("servo with a lag", SERVO, {"lag": 0.06}, {"lag": LAG}, SUSPECTED, with_filter),
    Case(
        "torque-driven arm with worn joints", ARM,
        {"damping shoulder": 1.6, "friction elbow": 0.4},
        {
            "damping shoulder": joint_number("shoulder", "damping", 0.8, 10.0),
            "friction elbow": joint_number("elbow", "frictionloss", 0.1, 5.0),
        },
        {"mass upper": mass_of("upper", 2.0), "mass lower": mass_of("lower", 1.0)},
        rate_hz=500.0, torques=(1.2, 0.6),
    ),
)  # fmt: skip


def own_example() -> Case:
    """The arm of mujoco.sysid's integration test: five armatures, all of which start from 0.01 kg·m²."""
    from mujoco.sysid.tests import test_integration as example

    xml = example.ARM_XML
    for value in example.TRUE_ARMATURE.values():
        xml = xml.replace(f'armature="{value}"', 'armature="0.01"')
    numbers = {f"armature {name}": joint_number(name, "armature", 0.01, 1.0) for name in example.JOINT_NAMES}
    truth = {f"armature {name}": value for name, value in example.TRUE_ARMATURE.items()}
    return Case(
        "its own example, five armatures",
        xml,
        truth,
        numbers,
        {},
        rate_hz=500.0,
        seconds=4.0,
        torques=(2.5, 2.0, 1.5, 1.0, 0.5),
    )


def specification(case: Case, numbers: Mapping[str, Number], values: Mapping[str, float]) -> Any:
    """The model with some numbers changed."""
    spec = mujoco.MjSpec.from_string(case.xml)
    if numbers is case.right:
        case.prepare(spec)
    for name, value in values.items():
        numbers[name].change(spec, value)
    return spec


def run(model: Any, controls: Array, rate_hz: float, joints: Array | None = None) -> Array:
    """Joints (n, nq) at the samples of held controls (n, nu), from rest as :func:`begin` has it."""
    data = mujoco.MjData(model)
    begin(model, data, controls[0], joints)
    steps, rows = round(1.0 / (rate_hz * model.opt.timestep)), np.empty((len(controls), model.nq))
    for k, control in enumerate(controls):
        rows[k] = data.qpos
        data.ctrl[:] = control
        mujoco.mj_step(model, data, steps)
    return rows


def begin(model: Any, data: Any, control: Array, joints: Array | None = None) -> None:
    """At rest, with the first control (nu,) held since long before.

    Args:
        joints: positions (nq,) [rad]; without them those of position commands, or hanging.
    """
    for k in range(model.nactuator):
        if model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE:
            data.qpos[model.jnt_qposadr[model.actuator_trnid[k, 0]]] = control[k]
        if model.actuator_dyntype[k] == mujoco.mjtDyn.mjDYN_FILTEREXACT:
            data.act[model.actuator_actadr[k]] = control[k]
        samples = int(model.actuator_history[k, 0])
        if samples:
            times = -model.opt.timestep * np.arange(samples, 0, -1)
            mujoco.mj_initCtrlHistory(model, data, k, times, np.full(samples, control[k]))
    if joints is not None:
        data.qpos[:] = joints


def controls_of(case: Case, model: Any, seed: int) -> Array:
    """Commands of one recording (n, nu): levels of a position servo, sums of sines of a motor."""
    rng, n = np.random.default_rng(seed), round(case.seconds * case.rate_hz)
    t = np.arange(n) / case.rate_hz
    columns = []
    for k in range(model.nu):
        reach = 0.5 * model.actuator_ctrlrange[k, 1]
        if model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE:
            length = round(0.8 * case.rate_hz)
            levels = np.repeat(rng.uniform(-reach, reach, n // length + 1), length)[:n]
            levels[:length] = 0.0
            columns.append(levels)
        else:
            waves = [
                0.5 * case.torques[k] * np.sin(2.0 * np.pi * f * t + p)
                for f, p in zip(rng.uniform(0.2, 1.2, 4), rng.uniform(0.0, 6.0, 4), strict=True)
            ]
            columns.append(np.sum(waves, axis=0) * np.minimum(1.0, t))
    return np.column_stack(columns)


def solve(case: Case, work: Path) -> list[dict[str, Any]]:
    """Rows of one case: the model under test, two choices of mujoco.sysid, and `sysid gap`."""
    folder = work / case.name.replace(" ", "-")
    folder.mkdir(parents=True, exist_ok=True)
    under_test = folder / "model.xml"
    under_test.write_text(case.xml, "utf-8")
    machine = machine_of(under_test, case.rate_hz)
    real = specification(case, case.right, case.truth).compile()
    controls = {name: controls_of(case, real, k) for k, name in enumerate(ROLES)}
    true = {name: run(real, values, case.rate_hz) for name, values in controls.items()}
    noisy = {
        name: rows + np.random.default_rng(100 + k).normal(0.0, NOISE, rows.shape)
        for k, (name, rows) in enumerate(true.items())
    }

    def row(method: str, found: str, model: Any, seconds: float) -> dict[str, Any]:
        held = [name for name, role in ROLES.items() if role == "held_out"]
        away = np.concatenate([run(model, controls[name], case.rate_hz) - true[name] for name in held])
        return {
            "case": case.name,
            "method": method,
            "found": found,
            "rmse": float(np.sqrt(np.mean(away**2))),
            "seconds": seconds,
        }

    rows = [row("model under test", "–", specification(case, {}, {}).compile(), 0.0)]
    for title, numbers in (("mujoco.sysid, right parameters", case.right), ("mujoco.sysid, other parameters", case.other)):
        if not numbers:
            continue
        values, seconds = peer(case, numbers, controls, noisy)
        text = ", ".join(f"{name} {value:.4g}" for name, value in values.items())
        rows.append(row(title, text, specification(case, numbers, values).compile(), seconds))
    found, path, seconds = ours(case, machine, under_test, folder, controls, noisy)
    rows.append(row("sysid gap", found, mujoco.MjModel.from_xml_path(str(path)), seconds))
    return rows


def machine_of(path: Path, rate_hz: float) -> Machine:
    """The description that ``sysid init --from`` drafts, with the noise of the sensors and the rate of the recordings."""
    files = dict(drafted_files(path, path.stem, Choices()).files)
    del files["recipe.toml"]
    names = machine_from_files(files, path.stem).axis_names
    lines = [f"rate_hz = {rate_hz}" if line.startswith("rate_hz") else line for line in files["machine.toml"].splitlines()]
    files["machine.toml"] = "\n".join(lines) + "\n[noise]\n" + "".join(f'"{name}.joint" = {NOISE}\n' for name in names)
    return machine_from_files(files, path.stem)


def peer(
    case: Case, numbers: Mapping[str, Number], controls: Mapping[str, Array], noisy: Mapping[str, Array]
) -> tuple[dict[str, float], float]:
    """Values of mujoco.sysid and its time [s]."""
    seen = {name: Motion(controls[name], noisy[name]) for name, role in ROLES.items() if role != "held_out"}
    return fitted_by_peer(specification(case, numbers, {}), numbers, seen, case.rate_hz)


@dataclass(frozen=True)
class Motion:
    """A recording as mujoco.sysid gets it.

    Args:
        controls: (n, nu) at the samples, held over them.
        measured: joints (n, nq) with noise [rad].
        start: joints (nq,) in which it begins at rest [rad]; None as of :func:`begin`.
    """

    controls: Array
    measured: Array
    start: Array | None = None


def fitted_by_peer(
    spec: Any, numbers: Mapping[str, Number], seen: Mapping[str, Motion], rate_hz: float
) -> tuple[dict[str, float], float]:
    """Values of mujoco.sysid and its time [s], with as many threads as there are cores for this process.

    Args:
        spec: the model under test, prepared for the numbers; its sensors are replaced.
        seen: recordings to fit.
    """
    from mujoco import sysid as peer_package

    if not hasattr(peer_package, "ParameterDict"):
        raise SettingsError("mujoco.sysid", "it lacks packages", "its own extra", "Type: pip install 'mujoco-core[sysid]'")
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    for joint in spec.joints:
        spec.add_sensor(
            name=f"{joint.name}_pos",
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=joint.name,
        )
    parameters = peer_package.ParameterDict()
    for name, number in numbers.items():
        parameters.add(
            peer_package.Parameter(
                name, nominal=number.start, min_value=number.low, max_value=number.high,
                modifier=lambda s, p, change=number.change: change(s, float(p.value[0])),
            )
        )  # fmt: skip
    model = spec.compile()
    held = round(1.0 / (rate_hz * model.opt.timestep))
    sequences = []
    for name, motion in seen.items():
        data = mujoco.MjData(model)
        begin(model, data, motion.controls[0], motion.start)
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        state = np.empty(size)
        mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        commands = np.repeat(motion.controls, held, axis=0)
        inputs = peer_package.TimeSeries(np.arange(len(commands)) * model.opt.timestep, commands)
        # A step of MuJoCo evaluates the sensors before it moves, and the rollout stamps them after it.
        stamps = np.arange(len(motion.measured)) / rate_hz + model.opt.timestep
        outputs = peer_package.TimeSeries.from_names(stamps[:-1], motion.measured[:-1], model)
        sequences.append(peer_package.ModelSequences(name, spec, name, state, inputs, outputs))
    begin_time = time.perf_counter()
    with contextlib.redirect_stdout(io.StringIO()):
        residual = peer_package.build_residual_fn(models_sequences=sequences, n_threads=cores())
        fitted, _ = peer_package.optimize(initial_params=parameters, residual_fn=residual, optimizer="mujoco", verbose=False)
    return {name: float(fitted[name].value[0]) for name in numbers}, time.perf_counter() - begin_time


def ours(
    case: Case, machine: Machine, model: Path, folder: Path, controls: Mapping[str, Array], noisy: Mapping[str, Array]
) -> tuple[str, Path, float]:
    """Named effects, the repaired file, and the time [s] for both."""
    recordings = []
    for name in ROLES:
        table = {"time": np.arange(len(noisy[name])) / case.rate_hz}
        for i, axis in enumerate(machine.axes):
            table[f"{axis.name}.command"] = controls[name][:, i]
            table[f"{axis.name}.joint"] = noisy[name][:, i]
        recordings.append(Recording(name, pd.DataFrame(table), case.rate_hz))
    dataset = Dataset.of(machine, recordings, ROLES)  # type: ignore[arg-type]
    begin_time, out = time.perf_counter(), folder / "repaired.xml"
    tested = open_model(model, dataset)
    result = find_gap(dataset, tested, forms="simple")  # MuJoCo has one friction for both directions
    path = write_model(model, tested, result, out, dataset).path if result.written else model
    named = [f"{e.name} ({e.target}) " + _values(e.parameters) for e in result.effects]
    return ", ".join(named) or result.verdict, path, time.perf_counter() - begin_time


def _values(parameters: Mapping[str, Any]) -> str:
    return " ".join(f"{value:.4g}" for value in parameters.values() if isinstance(value, float))


def tables(rows: Sequence[Mapping[str, Any]]) -> str:
    cells = [(r["case"], r["method"], r["found"], f"{1e3 * r['rmse']:.3g}", f"{r['seconds']:.1f}") for r in rows]
    return markdown(("machine", "method", "found (SI)", "held-out error [mrad]", "time [s]"), cells, "lllrr")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--only", default="", help="part of the name of a case")
    parser.add_argument(
        "--publish", action="store_true", help="write reports/mujoco_sysid/result.json and reports/mujoco_sysid/README.md"
    )
    args = parser.parse_args()
    rows = [row for case in (own_example(), *CASES) if args.only in case.name for row in solve(case, args.work)]
    Printer().block(tables(rows))
    if args.publish:
        head = provenance("python pipelines/mujoco_sysid.py --publish", None, ("mujoco-core",))
        write_result(ROOT / "reports/mujoco_sysid/result.json", {**head, "rows": rows})
        write_tables(ROOT / "reports/mujoco_sysid/README.md", tables(rows), "pipelines/mujoco_sysid.py")


if __name__ == "__main__":
    main()
