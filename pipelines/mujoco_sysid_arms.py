"""`sysid gap` on generated servo arms in MuJoCo beside mujoco.sysid, which is given exactly what is wrong.

    taskset -c 0 python pipelines/mujoco_sysid_arms.py --seeds 0:3 --work FOLDER [--publish]   # table of reports/mujoco_sysid

The arms are those of the row ``servo_arm`` (:mod:`arms.servo_arm`). Both methods get the same recordings, and every result is
an MJCF model whose run in MuJoCo is compared with the noise-free held-out recording. mujoco.sysid fits the hidden numbers
alone, from starts where they count, and begins its runs in the true joints; `sysid gap` gets the logs and tests all candidates.
Arms with nothing hidden, or with something that an MJCF has no number for, are left out. Each arm is solved in a process of its
own; one that has an answer is not solved again. On one core (taskset) both methods have one thread.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import pandas as pd

from arms import servo_arm
from arms.case import Hidden
from arms.servo_arm import ServoArm
from committed import markdown, provenance, write_result, write_tables
from electric_arms import seeds_of
from mujoco_sysid import ROLES, Motion, Number, fitted_by_peer, run
from sysid.datasets import Dataset, Recording
from sysid.errors import SysidError
from sysid.export.mjcf import MjcfTarget
from sysid.export.mjcf_servo import MujocoServos
from sysid.export.target import Start
from sysid.gap import find_gap
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import nominal_plant

Array = npt.NDArray[np.float64]
#: Where the table is published.
REPORT = Path(__file__).resolve().parents[1] / "reports" / "mujoco_sysid"
#: Longest dead time that mujoco.sysid may fit [s].
LATEST = 0.1


@dataclass(frozen=True)
class ArmCase:
    """An arm, what is hidden in it, and its recordings.

    Args:
        arm: as its model describes it.
        logs, clean: recording → table with and without noise.
        files: of the machine, as ``sysid init --from`` drafts them.
    """

    name: str
    rate_hz: float
    arm: ServoArm
    hidden: Sequence[Hidden]
    logs: Mapping[str, pd.DataFrame]
    clean: Mapping[str, pd.DataFrame]
    files: Mapping[str, str]

    def controls(self, recording: str) -> Array:
        """Commands of all joints (n, joints) [rad]."""
        return self.logs[recording][[f"{name}.command" for name in self.arm.names]].to_numpy()

    def joints(self, recording: str, noisy: bool) -> Array:
        """All joints (n, joints) [rad]."""
        tables = self.logs if noisy else self.clean
        return tables[recording][[f"{name}.joint" for name in self.arm.names]].to_numpy()


def arm_case(seed: int) -> ArmCase:
    """The arm of a seed; its four recordings have the names of :data:`mujoco_sysid.ROLES`."""
    case, draw = servo_arm.make(seed), np.random.default_rng([seed, 7])
    arm = servo_arm.random_arm(draw, int(draw.integers(2, 8)))
    logs, clean = (dict(zip(ROLES, tables.values(), strict=True)) for tables in (case.logs, case.clean))
    return ArmCase(case.name, case.rate_hz, arm, case.hidden, logs, clean, case.files)


# ---- What mujoco.sysid fits ------------------------------------------------------------------------------------------------


def numbers_of(arm: ServoArm, hidden: Sequence[Hidden]) -> dict[str, Number]:
    """Exactly the numbers that are hidden: shares of what the model has, dry friction as a share of kp [rad], dead time [s].

    Raises:
        KeyError: something hidden for which the model has no number.
    """
    return {label(each): NUMBERS[each.name](arm, arm.names.index(each.target)) for each in hidden}


def label(each: Hidden) -> str:
    return f"{each.name} {each.target}"


def _ratio(change: Callable[[Any, float], None], nominal: float, start: float = 1.0) -> Number:
    return Number(start, 0.3, 3.0, lambda spec, ratio: change(spec, ratio * nominal))


def _armature(arm: ServoArm, k: int) -> Number:
    return _ratio(lambda spec, value: setattr(spec.joint(arm.names[k]), "armature", value), arm.armature[k])


def _mass(arm: ServoArm, k: int) -> Number:
    return _ratio(lambda spec, value: setattr(spec.body(f"link{k}").geoms[0], "mass", value), arm.mass[k])


def _stiffness(arm: ServoArm, k: int) -> Number:
    def change(spec: Any, kp: float) -> None:
        actuator = spec.actuator(arm.names[k])
        actuator.gainprm[0], actuator.biasprm[1] = kp, -kp

    return _ratio(change, arm.kp[k])


def _damping(arm: ServoArm, k: int) -> Number:
    def change(spec: Any, kv: float) -> None:
        spec.actuator(arm.names[k]).biasprm[2] = -kv

    return _ratio(change, arm.kv[k])


def _limit(arm: ServoArm, k: int) -> Number:
    def change(spec: Any, limit: float) -> None:
        spec.actuator(arm.names[k]).forcerange = [-limit, limit]

    return _ratio(change, arm.limit[k])


def _friction(arm: ServoArm, k: int) -> Number:
    """It starts above zero, where it would be at its bound."""
    return Number(
        0.005, 0.0, 0.1, lambda spec, share: setattr(spec.joint(arm.names[k]), "frictionloss", share * float(arm.kp[k]))
    )


def _delay(arm: ServoArm, k: int) -> Number:
    def change(spec: Any, delay: float) -> None:
        actuator = spec.actuator(arm.names[k])
        actuator.delay, actuator.nsample, actuator.interp = delay, round(LATEST / servo_arm.STEP) + 2, 1

    return Number(0.01, servo_arm.STEP, LATEST, change)


#: Hidden effect → its number of a joint.
NUMBERS: dict[str, Callable[[ServoArm, int], Number]] = {
    "armature_error": _armature,
    "link_mass_error": _mass,
    "stiffness_error": _stiffness,
    "damping_error": _damping,
    "force_limit": _limit,
    "coulomb_friction": _friction,
    "input_delay": _delay,
}


def true_values(arm: ServoArm, hidden: Sequence[Hidden]) -> dict[str, float]:
    """The hidden values in the units of :func:`numbers_of`."""
    found = {}
    for each in hidden:
        (value,), k = each.parameters.values(), arm.names.index(each.target)
        unit = {"coulomb_friction": arm.kp, "force_limit": arm.limit}.get(each.name)
        found[label(each)] = float(value) / (float(unit[k]) if unit is not None else 1.0)
    return found


def changed_spec(arm: ServoArm, numbers: Mapping[str, Number], values: Mapping[str, float]) -> Any:
    """The model under test with numbers of mujoco.sysid."""
    spec = mujoco.MjSpec.from_string(servo_arm.model_text(arm))
    for name, value in values.items():
        numbers[name].change(spec, value)
    return spec


@dataclass(frozen=True)
class Seconds:
    """Time of a fit: on the clock, and of the processor, which programs beside it do not lengthen [s]."""

    wall: float
    processor: float


def peer(case: ArmCase) -> tuple[dict[str, float], Seconds]:
    """Values of mujoco.sysid and its time."""
    numbers = numbers_of(case.arm, case.hidden)
    spec = changed_spec(case.arm, numbers, {name: number.start for name, number in numbers.items()})
    seen = {
        name: Motion(case.controls(name), case.joints(name, noisy=True), case.joints(name, noisy=False)[0])
        for name, role in ROLES.items()
        if role != "held_out"
    }
    begin = time.process_time()
    values, wall = fitted_by_peer(spec, numbers, seen, case.rate_hz)
    return values, Seconds(wall, time.process_time() - begin)


# ---- What sysid finds ------------------------------------------------------------------------------------------------------


def ours(case: ArmCase, folder: Path) -> tuple[list[str], Seconds]:
    """Named effects, and the time of the search; the repaired MJCF and its loop are written into ``folder``."""
    machine = machine_from_files(dict(case.files), case.name)
    recordings = [Recording(name, table, case.rate_hz) for name, table in case.logs.items()]
    dataset = Dataset.of(machine, recordings, ROLES)  # type: ignore[arg-type]
    begin, processor = time.perf_counter(), time.process_time()
    result = find_gap(dataset, nominal_plant(machine))
    seconds = Seconds(time.perf_counter() - begin, time.process_time() - processor)
    effects = [KnownEffect(row.name, row.target, dict(row.parameters), row.side) for row in result.written]  # type: ignore[arg-type]
    write(case, effects, folder)
    return [f"{e.name} {e.target} " + _values(e.parameters) for e in result.effects], seconds


def write(case: ArmCase, effects: Sequence[KnownEffect], folder: Path) -> None:
    """The MJCF of the described machine with ``effects``, and its loop, into ``folder``, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    plant = nominal_plant(machine_from_files(dict(case.files), case.name))
    for effect in effects:
        plant = plant.with_effect(effect)
    MjcfTarget().write(plant, case.rate_hz, folder)


def known(hidden: Sequence[Hidden]) -> list[KnownEffect]:
    """What is hidden, as effects of a plant."""
    return [KnownEffect(each.name, each.target, dict(each.parameters)) for each in hidden]


def _values(parameters: Mapping[str, Any]) -> str:
    return " ".join(f"{value:.4g}" for value in parameters.values() if isinstance(value, float))


def run_written(folder: Path, controls: Array, joints: Array) -> Array:
    """Joints (n, joints) of a written MJCF [rad] at the samples of controls (n, joints), from rest at ``joints`` (joints,)."""
    arm = MujocoServos(folder)
    signals, rows = arm.reset(Start(joints, joints, controls[0], np.zeros(len(joints)))), np.empty(controls.shape)
    for k, control in enumerate(controls):
        rows[k] = [signals[f"{name}.joint"] for name in arm.arm.names]
        signals = arm.step(control)
    return rows


# ---- Both ------------------------------------------------------------------------------------------------------------------


def solve(seed: int, work: Path) -> dict[str, Any]:
    """The row of an arm: errors [rad] of the model under test and of both results on the held-out recording, times [s].

    An arm that is left out has the reason instead.
    """
    kept = work / f"{servo_arm.NAME}-{seed:03d}.json"
    if kept.exists():
        found: dict[str, Any] = json.loads(kept.read_text("utf-8"))
        return found
    case = arm_case(seed)
    about: dict[str, Any] = {"seed": seed, "joints": len(case.arm.mass), "rate_hz": case.rate_hz}
    about["hidden"] = [f"{label(each)} {_values(each.parameters)}" for each in case.hidden]
    beyond = [label(each) for each in case.hidden if each.name not in NUMBERS]
    if beyond or not case.hidden:
        row = {**about, "left_out": ", ".join(beyond) or "nothing hidden"}
    else:
        row = {**about, **_figures(case, work)}
    kept.write_text(json.dumps(row, indent=1) + "\n", "utf-8")
    return row


def _figures(case: ArmCase, work: Path) -> dict[str, Any]:
    held = next(name for name, role in ROLES.items() if role == "held_out")
    controls, true = case.controls(held), case.joints(held, noisy=False)

    def error(rows: Array) -> float:
        return float(np.sqrt(np.mean((rows - true) ** 2)))

    def of_spec(values: Mapping[str, float]) -> float:
        spec = changed_spec(case.arm, numbers_of(case.arm, case.hidden), values)
        return error(run(spec.compile(), controls, case.rate_hz, true[0]))

    folder = work / case.name
    write(case, known(case.hidden), folder / "truth")
    values, peer_seconds = peer(case)
    found: dict[str, Any] = {"under_test": of_spec({}), "peer": of_spec(values), "peer_seconds": asdict(peer_seconds)}
    found |= {"written_truth": error(run_written(folder / "truth", controls, true[0]))}
    found |= {"peer_values": values, "true_values": true_values(case.arm, case.hidden)}
    try:
        named, seconds = ours(case, folder / "repaired")
    except SysidError as failed:
        return found | {"failed": str(failed)}
    repaired = error(run_written(folder / "repaired", controls, true[0]))
    return found | {"ours": repaired, "ours_seconds": asdict(seconds), "named": named}


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """One line an arm, errors in mrad, times of the processor in seconds; and the medians of both ratios.

    ``truth``: error of the MJCF that sysid writes with exactly what is hidden, which no search undercuts by much.
    """
    header = ["seed", "joints", "rate [Hz]", "hidden", "under test", "mujoco.sysid", "sysid gap", "truth", "ratio"]
    header += ["mujoco.sysid [s]", "sysid gap [s]", "ratio", "named by sysid gap"]
    lines = []
    for row in rows:
        cells = [str(row["seed"]), str(row["joints"]), f"{row['rate_hz']:g}", ", ".join(row["hidden"])]
        if "left_out" in row:
            cells += ["–"] * 8 + [f"left out: {row['left_out']}"]
        elif "failed" in row:
            cells += [*(f"{1e3 * row[key]:.3g}" for key in ("under_test", "peer")), *["–"] * 6, row["failed"]]
        else:
            cells += [f"{1e3 * row[key]:.3g}" for key in ("under_test", "peer", "ours", "written_truth")]
            cells += [f"{row['ours'] / row['peer']:.2f}", *(f"{row[key]['processor']:.1f}" for key in SECONDS)]
            cells += [f"{_slower(row):.1f}", ", ".join(row["named"]) or "nothing"]
        lines.append(cells)
    solved = [row for row in rows if "ours" in row]
    if not solved:
        return markdown(header, lines, "rrrlrrrrrrrrl")
    error, slower = (
        float(np.median([ratio(row) for row in solved])) for ratio in (lambda row: row["ours"] / row["peer"], _slower)
    )
    medians = f"Medians of {len(solved)} arms: {error:.2f} times its error, {slower:.1f} times its time."
    return f"{markdown(header, lines, 'rrrlrrrrrrrrl')}\n\n{medians}"


#: Times of both methods in a row.
SECONDS = ("peer_seconds", "ours_seconds")


def _slower(row: Mapping[str, Any]) -> float:
    """Ratio of the processor times of `sysid gap` and mujoco.sysid."""
    peer_seconds, ours_seconds = (float(row[key]["processor"]) for key in SECONDS)
    return ours_seconds / peer_seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0:1", help="FIRST:LAST, both included")
    parser.add_argument("--work", type=Path, required=True, help="folder of answers and repaired models")
    parser.add_argument("--publish", action="store_true", help="write reports/mujoco_sysid/arms.json and the table of its page")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    rows = []
    for seed in seeds_of(args.seeds):
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            rows.append(pool.submit(solve, seed, args.work).result())
        print(table(rows[-1:]).splitlines()[2], flush=True)
    print("\n" + table(rows))
    if args.publish:
        head = provenance(f"python pipelines/mujoco_sysid_arms.py --seeds {args.seeds} --publish", None, ("mujoco-core",))
        write_result(REPORT / "arms.json", {**head, "arms": rows})
        write_tables(REPORT / "README.md", table(rows), "pipelines/mujoco_sysid_arms.py")


if __name__ == "__main__":
    main()
