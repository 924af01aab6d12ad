"""A public arm that is not as its model says: hidden, logged in MuJoCo, found, repaired. `make demo-arm`, `sysid demo --arm`.

    sysid demo --arm [--hide friction:joint2=6 --hide mass:joint4=1.5 …]

The arm is a Franka Emika Panda with its hand: kinematics, masses and shapes are those of the URDF in the package pybullet
(Apache-2.0, franka_panda/LICENSE.txt there), position controllers those of :data:`STIFFNESS` and :data:`DAMPING`. Its user has
the model; the machine is the same model with other numbers, and records four runs with noisy encoders. No number of
:data:`HIDDEN` is used between the recording and the comparison at the end.
"""

from __future__ import annotations

import argparse
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

import sysid
from sysid.cli.gap_tables import show_gap
from sysid.cli.output import PipelineProgress, Printer, write_json
from sysid.datasets.robot_files import Choices, drafted_files
from sysid.display import quantity
from sysid.errors import SettingsError, nearest
from sysid.pictures import PictureCurve, svg

Array = npt.NDArray[np.float64]
JOINTS = tuple(f"joint{k}" for k in range(1, 8))
#: Of the controllers [N·m/rad, N·m·s/rad], inertia of the rotors [kg·m²], viscous friction [N·m·s/rad]; limits are the URDF's.
STIFFNESS = np.array([4500.0, 4500.0, 3500.0, 3500.0, 2000.0, 2000.0, 2000.0])
DAMPING = 0.1 * STIFFNESS
ARMATURE, FRICTION = 0.5, 1.0
#: Middle of all motions, and their size [rad].
HOME, REACH = np.array([0.0, -0.6, 0.0, -1.9, 0.0, 1.6, 0.6]), np.array([0.8, 0.5, 0.8, 0.6, 0.8, 0.8, 0.8])
#: Step of the simulation [s], rate of the logs [Hz], length of each [s], noise of the encoders [rad].
STEP, RATE, SECONDS, NOISE = 2e-3, 100.0, 20.0, 2e-4
RECORDINGS = ("fast-1", "smooth-1", "fast-2", "smooth-2")
#: What is hidden, unless the user says what.
HIDDEN = ("friction:joint2=6", "armature:joint4=1.8", "delay:joint1=0.04")


@dataclass(frozen=True)
class Kind:
    """Something that can be hidden.

    Args:
        effect, parameter: its name as an effect.
        low, high: of its value.
        change: writes it into the model of a joint.
    """

    effect: str
    parameter: str
    unit: str
    low: float
    high: float
    change: Callable[[Any, int, float], None]


def _friction(spec: Any, k: int, force: float) -> None:
    spec.joint(JOINTS[k]).frictionloss = force


def _armature(spec: Any, k: int, ratio: float) -> None:
    spec.joint(JOINTS[k]).armature *= ratio


def _mass(spec: Any, k: int, ratio: float) -> None:
    body = spec.body(f"link{k + 1}")
    body.mass, body.inertia = ratio * body.mass, ratio * np.asarray(body.inertia)


def _stiffness(spec: Any, k: int, ratio: float) -> None:
    actuator = spec.actuator(JOINTS[k])
    actuator.gainprm[0], actuator.biasprm[1] = ratio * STIFFNESS[k], -ratio * STIFFNESS[k]


def _damping(spec: Any, k: int, ratio: float) -> None:
    spec.actuator(JOINTS[k]).biasprm[2] = -ratio * DAMPING[k]


def _delay(spec: Any, k: int, delay: float) -> None:
    actuator = spec.actuator(JOINTS[k])
    actuator.delay, actuator.nsample, actuator.interp = delay, round(delay / STEP) + 2, 1


KINDS = {
    "friction": Kind("coulomb_friction", "force", "N·m", 0.0, 40.0, _friction),
    "armature": Kind("armature_error", "ratio", "times the model's", 0.2, 5.0, _armature),
    "mass": Kind("link_mass_error", "ratio", "times the model's", 0.2, 5.0, _mass),
    "stiffness": Kind("stiffness_error", "ratio", "times the model's", 0.3, 3.0, _stiffness),
    "damping": Kind("damping_error", "ratio", "times the model's", 0.3, 3.0, _damping),
    "delay": Kind("input_delay", "delay", "s", 0.0, 0.2, _delay),
}


@dataclass(frozen=True)
class Hidden:
    """One thing that the machine has and its model has not."""

    kind: Kind
    joint: int
    value: float

    @property
    def key(self) -> tuple[str, str]:
        """Name and target of the effect."""
        return self.kind.effect, JOINTS[self.joint]


def hidden_of(text: str) -> Hidden:
    """``friction:joint2=6``.

    Raises:
        SettingsError: not of this form, no such kind or joint, or a value outside of its range.
    """
    found = re.fullmatch(r"(\w+):(\w+)=([-+.\deE]+)", text)
    where = f"--hide {text}"
    if found is None:
        raise SettingsError(where, "no KIND:JOINT=VALUE", f"for example {HIDDEN[0]}; kinds: {', '.join(KINDS)}")
    name, joint, number = found.groups()
    if name not in KINDS:
        raise SettingsError(where, f"no kind {name!r}", nearest(name, KINDS))
    if joint not in JOINTS:
        raise SettingsError(where, f"no joint {joint!r}", nearest(joint, JOINTS))
    kind = KINDS[name]
    try:
        value = float(number)
    except ValueError:
        value = np.nan
    if not kind.low <= value <= kind.high:
        raise SettingsError(where, f"the value {number}", f"{kind.low:g} to {kind.high:g} {kind.unit}")
    return Hidden(kind, JOINTS.index(joint), value)


# ---- The model that the user has, and the machine -------------------------------------------------------------------------


def shapes() -> Any:
    """The compiled URDF: one body a link, with its shape; the fingers are held.

    Raises:
        ModuleNotFoundError: pybullet or mujoco is not installed.
    """
    import mujoco
    import pybullet_data

    folder = Path(pybullet_data.getDataPath()) / "franka_panda"
    text = re.sub(r"package://meshes/\w+/", "", (folder / "panda.urdf").read_text("utf-8")).replace("prismatic", "fixed")
    compiler = f'<mujoco><compiler meshdir="{folder}/meshes/collision" fusestatic="true" balanceinertia="true"/></mujoco>'
    return mujoco.MjModel.from_xml_string(re.sub(r"(<robot[^>]*>)", rf"\1{compiler}", text, count=1))


def model_text(model: Any) -> str:
    """The MJCF of the arm: kinematics and masses of ``model``, with position controllers."""

    def listed(values: Sequence[float]) -> str:
        return " ".join(f"{value:.9g}" for value in values)

    bodies, actuators = "", ""
    for k, name in enumerate(JOINTS):
        b = k + 1
        low, high = model.jnt_range[k]
        bodies += (
            f'<body name="link{b}" pos="{listed(model.body_pos[b])}" quat="{listed(model.body_quat[b])}">'
            f'<inertial pos="{listed(model.body_ipos[b])}" quat="{listed(model.body_iquat[b])}" '
            f'mass="{model.body_mass[b]:.9g}" diaginertia="{listed(model.body_inertia[b])}"/>'
            f'<joint name="{name}" pos="{listed(model.jnt_pos[k])}" axis="{listed(model.jnt_axis[k])}" range="{low} {high}" '
            f'armature="{ARMATURE}" damping="{FRICTION}"/>'
        )
        actuators += (
            f'<position name="{name}" joint="{name}" kp="{STIFFNESS[k]:g}" kv="{DAMPING[k]:g}" ctrlrange="{low} {high}"/>'
        )
    return (
        f'<mujoco model="panda"><compiler angle="radian"/><option timestep="{STEP}" integrator="implicitfast"/>'
        f'<worldbody>{bodies}<site name="tip" pos="0 0 0.21"/>{"</body>" * len(JOINTS)}</worldbody>'
        f"<actuator>{actuators}</actuator></mujoco>"
    )


def commands(smooth: bool, draw: np.random.Generator) -> Array:
    """Setpoints (n, joints) [rad]: sums of sines, or a new one for every joint each second or so."""
    count = round(SECONDS * RATE)
    time = np.arange(count) / RATE
    if smooth:
        rates, phases = draw.uniform(0.1, 0.7, (7, 4)), draw.uniform(0.0, 2.0 * np.pi, (7, 4))
        waves = np.sin(2.0 * np.pi * rates[:, :, None] * time + phases[:, :, None]) - np.sin(phases)[:, :, None]
        return np.asarray(HOME + 0.3 * REACH * waves.sum(axis=1).T)
    wanted = np.tile(HOME, (count, 1))
    for k in range(len(JOINTS)):
        at = round(RATE)
        while at < count:
            ahead = at + round(draw.uniform(0.5, 1.5) * RATE)
            wanted[at:ahead, k], at = HOME[k] + REACH[k] * draw.uniform(-1.0, 1.0), ahead
    return wanted


def record(text: str, hidden: Sequence[Hidden], folder: Path) -> None:
    """The runs of the machine as CSV below ``folder``, each from rest."""
    import mujoco

    spec = mujoco.MjSpec.from_string(text)
    for each in hidden:
        each.kind.change(spec, each.joint, each.value)
    model, every = spec.compile(), round(1.0 / (RATE * STEP))
    for seed, name in enumerate(RECORDINGS):
        draw, data = np.random.default_rng(seed), mujoco.MjData(model)
        wanted = commands(name.startswith("smooth"), draw)
        data.qpos[:], data.ctrl[:] = wanted[0], wanted[0]
        mujoco.mj_step(model, data, round(3.0 / STEP))
        joints = np.empty_like(wanted)
        for k, row in enumerate(wanted):
            joints[k], data.ctrl[:] = data.qpos, row
            mujoco.mj_step(model, data, every)
        table: dict[str, Array] = {"time": np.arange(len(wanted)) / RATE}
        table |= {f"{joint}.command": wanted[:, k] for k, joint in enumerate(JOINTS)}
        table |= {f"{joint}.joint": joints[:, k] + draw.normal(0.0, NOISE, len(wanted)) for k, joint in enumerate(JOINTS)}
        (folder / name).mkdir(parents=True)
        pd.DataFrame(table).to_csv(folder / name / "log.csv", index=False)


# ---- The workflow ---------------------------------------------------------------------------------------------------------


def main(workspace: Path, hide: Sequence[str] = HIDDEN) -> Path:
    """Hide, record, find and repair; returns the path of ``<workspace>/demo-arm/result.json``.

    Raises:
        SettingsError: something that cannot be hidden.
    """
    hidden, out = [hidden_of(text) for text in hide], Printer()
    if len({each.key for each in hidden}) < len(hidden):
        raise SettingsError("--hide", "the same kind twice on a joint", "each once")
    place, step = sysid.open(workspace), PipelineProgress(out)
    folder = place.root.make("demo-arm")
    for old in ("logs", "repaired"):
        shutil.rmtree(folder / old, ignore_errors=True)
    model = shapes()
    (folder / "panda.xml").write_text(model_text(model), "utf-8")
    with step("record"):
        record(model_text(model), hidden, folder / "logs")
    drafted = dict(drafted_files(folder / "panda.xml", "panda", Choices()).files)
    machine = re.sub(r"(?m)^rate_hz = .*$", f"rate_hz = {RATE}", drafted["machine.toml"])
    drafted["machine.toml"] = machine + "\n[noise]\n" + "".join(f'"{joint}.joint" = {NOISE}\n' for joint in JOINTS)
    for name, text in drafted.items():
        (folder / name).write_text(text, "utf-8")
    with step("ingest") as progress:
        dataset = sysid.ingest(
            folder / "logs", place, machine=folder / "machine.toml", recipe=folder / "recipe.toml", progress=progress
        )
    with step("gap") as progress:
        gap = sysid.find_gap(dataset, workspace=place, world=False, progress=progress)
    files: dict[str, Path] = {}
    if gap.result.plant_after:
        with step("export"):
            gap.repaired.export("mjcf", folder / "repaired")
        files["mjcf"] = folder / "repaired"
    if gap.result.traces:
        files["picture"] = folder / "arm.svg"
        files["picture"].write_text(picture(model, gap), "utf-8")
    files["report"] = sysid.report(dataset, folder / "report.html", place)

    show_gap(out, gap.result, dataset)
    rows = compared(hidden, gap)
    out.table(("hidden", "of", "true value", "found", "95 % interval"), rows)
    right = sum(row[3] != "not named" for row in rows)
    wrong = [f"{name} of {target}" for name, target in wrongly_named(hidden, gap)]
    out.line(f"Named: {right} of {len(hidden)} hidden; wrong names: {', '.join(wrong) or 'none'}")
    for name, path in files.items():
        out.line(f"{name:<8} {path}")
    result = {
        "schema": 1, "hidden": list(hide), "named": right, "wrong": wrong, "gap": gap.result.to_json(), "files": files,
        "seconds": step.seconds,
    }  # fmt: skip
    write_json(folder / "result.json", result)
    return folder / "result.json"


def compared(hidden: Sequence[Hidden], gap: sysid.GapResult) -> list[tuple[str, ...]]:
    """What was hidden beside what was found."""
    found = {(effect.name, effect.target): effect for effect in gap.effects}
    rows = []
    for each in hidden:
        effect, kind = found.get(each.key), each.kind
        cells = ("not named", "")
        if effect is not None:
            ends = effect.interval95.get(kind.parameter)
            cells = (f"{effect.parameters[kind.parameter]:.4g}", "" if ends is None else f"{ends[0]:.4g} to {ends[1]:.4g}")
        rows.append((kind.effect, JOINTS[each.joint], f"{each.value:g} {kind.unit}", *cells))
    return rows


def wrongly_named(hidden: Sequence[Hidden], gap: sysid.GapResult) -> list[tuple[str, str]]:
    """Names that were not hidden, under none of their aliases."""
    keys = {each.key for each in hidden}
    return [(e.name, e.target) for e in gap.effects if not keys & {(e.name, e.target), *e.aliases}]


# ---- The picture ----------------------------------------------------------------------------------------------------------

PANEL, HEIGHT, MEASURED, BEFORE, AFTER = 230, 240, "#8b949e", "#d9822b", "#1a7f64"


def picture(model: Any, gap: sysid.GapResult) -> str:
    """The arm at its largest error on the held-out recording, before and after, and the motion of its worst joint."""
    trace = gap.result.traces[0]
    tables = {"measured": trace.measured, "before": trace.before, "after": trace.after}
    errors = {key: _errors(trace.measured, tables[key]) for key in ("before", "after")}
    row = int(np.nanargmax(errors["before"].max(axis=1)))
    joint = f"{JOINTS[int(np.nanargmax(errors['before'].max(axis=0)))]}.joint"
    poses = {key: _links(model, table, row) for key, table in tables.items()}
    every = np.concatenate([points for links in poses.values() for points in links])
    low, high = every.min(axis=0), every.max(axis=0)
    scale = min((PANEL - 30.0) / (high - low)[0], (HEIGHT - 45.0) / (high - low)[1])
    parts = []
    for left, key, colour in ((15.0, "before", BEFORE), (PANEL + 15.0, "after", AFTER)):
        origin, turned = np.array([left, HEIGHT - 10.0]), np.array([scale, -scale])
        for which, look in (("measured", f'fill="{MEASURED}"'), (key, f'fill="{colour}" fill-opacity="0.55"')):
            for points in poses[which]:
                text = " ".join(f"{x:.1f},{y:.1f}" for x, y in origin + (points - low) * turned)
                parts.append(f'<polygon points="{text}" {look} stroke="#ffffff" stroke-width="0.5"/>')
        error = quantity(float(errors[key][row].max()), "rad")
        parts.append(f'<text x="{left}" y="16" fill="#30363c">{key}: off by {error}</text>')
    time = trace.measured["time"].to_numpy() - trace.measured["time"].iloc[0]
    shown = (time > time[row] - 2.0) & (time < time[row] + 2.0)
    curves = [
        PictureCurve(label, time[shown], np.degrees(table[joint].to_numpy()[shown]), colour, dashed)
        for label, table, colour, dashed in (
            ("simulated before", trace.before, BEFORE, False),
            ("measured", trace.measured, "#30363c", False),
            ("simulated after", trace.after, AFTER, True),
        )
    ]
    rms = " → ".join(quantity(figures[joint], "rad") for figures in (gap.result.gap.before, gap.result.gap.after))
    title = f"RMS error of {joint} on {trace.recording}: {rms}"
    curve = svg(title, f"time [s] · {title}", f"{joint} [°]", curves).replace("<svg ", f'<svg x="{2 * PANEL}" ', 1)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {2 * PANEL + 640} {HEIGHT}" font-family="sans-serif" '
        f'font-size="13" role="img"><title>{title}</title><rect width="100%" height="100%" fill="#ffffff"/>\n'
        + "\n".join(parts)
        + f"\n{curve}</svg>\n"
    )


def _errors(measured: Mapping[str, pd.Series], simulated: Mapping[str, pd.Series]) -> Array:
    """Error of each joint (n, joints) [rad]."""
    columns = [f"{joint}.joint" for joint in JOINTS]
    return np.abs(np.column_stack([measured[name].to_numpy() - simulated[name].to_numpy() for name in columns]))


def _links(model: Any, table: pd.DataFrame, row: int) -> list[Array]:
    """Outlines (n, 2) of the links [m], seen from the side and a little from above, in MuJoCo's pose of a row."""
    import mujoco
    from scipy.spatial import ConvexHull

    data = mujoco.MjData(model)
    data.qpos[:] = [table[f"{joint}.joint"].iloc[row] for joint in JOINTS]
    mujoco.mj_kinematics(model, data)
    turn, tilt = np.radians(35.0), np.radians(20.0)
    right = np.array([np.cos(turn), np.sin(turn), 0.0])
    up = np.array([-np.sin(tilt) * -np.sin(turn), -np.sin(tilt) * np.cos(turn), np.cos(tilt)])
    outlines = []
    for geom in range(model.ngeom):
        mesh = int(model.geom_dataid[geom])
        begin, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        points = model.mesh_vert[begin : begin + count] @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        flat = np.column_stack([points @ right, points @ up])
        outlines.append(flat[ConvexHull(flat).vertices])
    return outlines


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workspace", type=Path, default=Path("workspace"))
    parser.add_argument("--hide", action="append", metavar="KIND:JOINT=VALUE")
    given = parser.parse_args()
    main(given.workspace, given.hide or HIDDEN)
