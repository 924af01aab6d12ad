"""A small crane with made-up but plausible logs and findings: what the report and the viewer are developed against."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import ClockRecord, Dataset, Recording, Source
from sysid.gap.result import (
    Alternative,
    ComparedModel,
    Excitation,
    Gap,
    GapResult,
    Map,
    NamedEffect,
    Share,
    StageGap,
    Traces,
    Unnamed,
)
from sysid.machine import Machine, machine_from_files

Array = npt.NDArray[np.float64]

URDF = """<robot name="crane">
  <link name="base"><visual><origin xyz="0 0 0.08"/><geometry><box size="0.4 0.4 0.16"/></geometry></visual></link>
  <link name="column"><visual><origin xyz="0 0 0.1"/><geometry><cylinder radius="0.05" length="0.2"/></geometry></visual></link>
  <link name="boom"><visual><origin xyz="0.288 0 0"/><geometry><box size="0.576 0.06 0.07"/></geometry></visual></link>
  <link name="stick"><visual><origin xyz="0.2 0 0"/><geometry><box size="0.4 0.05 0.05"/></geometry></visual></link>
  <link name="boom_tip"><visual><origin xyz="-0.12 0 0"/><geometry><box size="0.24 0.035 0.035"/></geometry></visual></link>
  <link name="gripper"><visual><origin xyz="0 0 0"/><geometry><sphere radius="0.04"/></geometry></visual></link>
  <joint name="slew_joint" type="revolute"><parent link="base"/><child link="column"/>
    <origin xyz="0 0 0.16"/><axis xyz="0 0 1"/><limit lower="-2.6" upper="2.6"/></joint>
  <joint name="boom_joint" type="revolute"><parent link="column"/><child link="boom"/>
    <origin xyz="0 0 0.125"/><axis xyz="0 -1 0"/><limit lower="-0.43" upper="1.4"/></joint>
  <joint name="stick_joint" type="revolute"><parent link="boom"/><child link="stick"/>
    <origin xyz="0.576 0 0"/><axis xyz="0 -1 0"/><limit lower="-2.6" upper="-0.1"/></joint>
  <joint name="telescope_joint" type="prismatic"><parent link="stick"/><child link="boom_tip"/>
    <origin xyz="0.4 0 0"/><axis xyz="1 0 0"/><limit lower="0" upper="0.25"/></joint>
  <joint name="gripper_joint" type="revolute"><parent link="boom_tip"/><child link="gripper"/>
    <origin xyz="0 0 -0.22"/><axis xyz="0 1 0"/><limit lower="-1.5" upper="1.5"/></joint>
</robot>
"""

MACHINE = """
schema = 1
name = "autolog"
rate_hz = 100.0
urdf = "crane.urdf"
tip = "boom_tip"
tool = "gripper"
[noise]
"boom.cylinder" = 1e-4
[[axes]]
name = "slew"
joint = "slew_joint"
actuation = "velocity"
drives = "joint"
gain = 0.436
[[axes]]
name = "boom"
joint = "boom_joint"
actuation = "velocity"
drives = "cylinder"
gain = 0.025
stroke = [0.0, 0.101]
[[axes]]
name = "stick"
joint = "stick_joint"
actuation = "velocity"
drives = "cylinder"
gain = 0.035
stroke = [0.0, 0.135]
[[axes]]
name = "telescope"
joint = "telescope_joint"
actuation = "velocity"
drives = "joint"
gain = 0.1
[[effects]]
name = "valve_deadband"
target = "slew"
parameters = { positive = 0.12, negative = 0.10 }
"""

DEADBAND = (0.081, 0.049)
PLAY = 0.0105
ROLES = {"manual-01": "fit", "manual-02": "fit", "manual-03": "select", "manual-04": "held_out", "poses": "fit"}


def sample_machine() -> Machine:
    return machine_from_files({"machine.toml": MACHINE, "crane.urdf": URDF}, where="sample")


def commands(seconds: float, rate_hz: float, seed: int) -> dict[str, Array]:
    """Smooth joystick strokes with rests between them."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    result = {}
    for axis in ("slew", "boom", "stick", "telescope"):
        value = np.zeros_like(time)
        start, sign = 1.0, 1.0
        while start < seconds - 2.0:
            length = rng.uniform(0.8, 2.5)
            phase = np.clip((time - start) / length, 0.0, 1.0)
            value += sign * rng.uniform(0.15, 0.9) * np.sin(np.pi * phase) ** 2
            start, sign = start + length + rng.uniform(0.0, 1.0), -sign
        result[axis] = value
    return result


def simulate(command: dict[str, Array], rate_hz: float, repaired: bool) -> pd.DataFrame:
    """All signals of the sample machine; ``repaired`` with the dead-band, play and sway that its logs hide."""
    machine = sample_machine()
    dt = 1.0 / rate_hz
    start = {"slew": 0.0, "boom": 0.05, "stick": 0.06, "telescope": 0.1}
    columns: dict[str, Array] = {"time": np.arange(len(command["slew"])) * dt}
    joints = []
    for axis in machine.axes:
        u = command[axis.name]
        if repaired and axis.name == "boom":
            u = np.where(u > DEADBAND[0], u - DEADBAND[0], np.where(u < -DEADBAND[1], u + DEADBAND[1], 0.0))
        driven = start[axis.name] + np.cumsum(axis.gain * u) * dt
        if repaired and axis.name == "slew":
            driven = play(driven, PLAY)
        columns[f"{axis.name}.command"] = command[axis.name]
        if axis.drives == "cylinder":
            columns[f"{axis.name}.cylinder"] = driven
            low, high = axis.limits or (0.0, 1.0)
            driven = low + (high - low) * driven / (axis.stroke or (0.0, 1.0))[1]
        columns[f"{axis.name}.joint"] = driven
        joints.append(driven)
    kinematics = machine.kinematics()
    assert kinematics is not None
    tip = kinematics.tip_position(np.column_stack(joints))
    tool = tip - np.array([0.0, 0.0, 0.22])
    if repaired:
        tool[:, :2] += 0.02 * np.sin(2 * np.pi * 1.05 * columns["time"])[:, None] * np.array([1.0, 0.4])
    for number, name in enumerate("xyz"):
        columns[f"ee.{name}"] = tip[:, number]
        columns[f"tool.{name}"] = tool[:, number]
    return pd.DataFrame(columns)


def play(x: Array, width: float) -> Array:
    """Output of a play of full ``width``."""
    y = np.empty_like(x)
    held = x[0]
    for i, value in enumerate(x):
        held = min(max(held, value - width / 2), value + width / 2)
        y[i] = held
    return y


def measured(table: pd.DataFrame, seed: int) -> pd.DataFrame:
    """The table with sensor noise and a drop-out of the motion capture."""
    rng = np.random.default_rng(seed)
    table = table.copy()
    for name in table.columns:
        if name != "time" and not name.endswith(".command"):
            table[name] = table[name] + rng.normal(0.0, 2e-4, len(table))
    gap = table["time"].between(12.0, 12.4)
    table.loc[gap, [name for name in table.columns if name.startswith(("ee.", "tool."))]] = np.nan
    return table


def sample_dataset(seconds: float = 30.0) -> Dataset:
    """Four driven recordings and one of 60 static poses."""
    recordings = [
        Recording(name, measured(simulate(commands(seconds, 100.0, seed), 100.0, repaired=True), seed), 100.0)
        for seed, name in enumerate(("manual-01", "manual-02", "manual-03", "manual-04"))
    ]
    rows = recordings[0].table.dropna().iloc[:: max(1, len(recordings[0].table) // 60)].reset_index(drop=True)
    recordings.append(Recording("poses", rows, 100.0, kind="poses"))
    machine = sample_machine()
    units = {name: machine.expected_unit(name) or "1" for name in recordings[0].signals}
    clocks = tuple(
        ClockRecord(
            name, "mocap", -1.2345678, 42.3, (-1.23462, -1.23451), (39.1, 45.5), 2.1e-4, ("slew.joint", "telescope.joint"), True
        )
        for name in ROLES
        if name != "poses"
    )
    refused = replace(
        clocks[0], recording="poses", applied=False, reason="the machine stands still: nothing to align on", used_signals=()
    )
    sources = tuple(
        Source(
            f"{name}/machine.mcap", hashlib.sha256(name.encode()).hexdigest(), 1_234_567, ("truncated: last 0.31 s unreadable",)
        )
        if name == "manual-02"
        else Source(f"{name}/machine.mcap", hashlib.sha256(name.encode()).hexdigest(), 1_234_567)
        for name in ROLES
    )
    quality = {
        name: {"duration_s": seconds, "gap_share": {"ee.x": 0.013, "boom.cylinder": 0.0}, "flags": ["marker swap at 8.2 s"]}
        for name in ROLES
    }
    return Dataset("autolog", 3, "ab" * 32, machine, tuple(recordings), units, ROLES, sources, (*clocks, refused), quality)  # type: ignore[arg-type]


def rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


def sample_traces(dataset: Dataset) -> Traces:
    recording = dataset.recording("manual-04")
    command = {axis: recording.values(f"{axis}.command") for axis in dataset.machine.axis_names}
    signals = [name for name in recording.signals if not name.endswith(".command")]
    before = simulate(command, recording.rate_hz, repaired=False)[["time", *signals]]
    after = simulate(command, recording.rate_hz, repaired=True)[["time", *signals]]
    return Traces(recording.name, recording.table[["time", *recording.signals]], before, after)


def sample_gap(dataset: Dataset) -> GapResult:
    """Three effects named on the sample dataset, with everything that a report shows."""
    traces = sample_traces(dataset)
    signals = [name for name in traces.before.columns if name != "time"]
    gap = Gap(
        {name: rms(traces.before[name].to_numpy() - traces.measured[name].to_numpy()) for name in signals},
        {name: rms(traces.after[name].to_numpy() - traces.measured[name].to_numpy()) for name in signals},
        dict.fromkeys(signals, 0.0002),
    )
    stage_of = {"cylinder": "command", "joint": "joint"}
    localised = []
    for name in signals:
        owner, _, quantity = name.rpartition(".")
        stage = {"ee": "end_effector", "tool": "tool"}.get(owner, stage_of.get(quantity, "joint"))
        if quantity == "joint" and owner in ("slew", "telescope"):
            stage = "command"
        at_fault = name in ("boom.cylinder", "slew.joint") or owner == "tool"
        stage_rmse = gap.before[name] if at_fault else 2.1e-4
        share = {"boom.cylinder": 0.52, "slew.joint": 0.21, "tool.x": 0.18, "tool.y": 0.09}.get(name, 0.0)
        localised.append(StageGap(stage, owner, name, stage_rmse, gap.before[name], 2e-4, share))
    effects = (
        NamedEffect(
            "valve_deadband",
            "boom",
            {"positive": 0.0808, "negative": 0.0493},
            {"positive": (0.0782, 0.0836), "negative": (0.0461, 0.0518)},
            0.63,
            (
                Alternative("gain_curve", "boom", "predicts 3140 ± 80 nats worse"),
                Alternative("backlash", "boom", "predicts 310 ± 25 nats worse"),
            ),
        ),
        NamedEffect(
            "backlash",
            "slew",
            {"width": 0.01052},
            {"width": (0.01041, 0.01066)},
            0.21,
            (Alternative("valve_deadband", "slew", "predicts 95 ± 11 nats worse"),),
            side="structure",
        ),
        NamedEffect(
            "gripper_sway",
            "tool",
            {"length": 0.2196, "damping_ratio": 0.041},
            {"length": (0.2183, 0.2210), "damping_ratio": (0.036, 0.047)},
            0.16,
        ),
    )
    candidates = (
        ComparedModel("command", "boom", (), {}, 68.1, 71.3, 9120.0, "4560 ± 90 nats worse"),
        _trial("valve_deadband(boom)", {"positive": 0.0808, "negative": 0.0493}, 1.01, 0.99, 0.0, "survives"),
        _trial("gain_error(boom)", {"ratio": 0.91}, 31.0, 36.2, 5133.0, "2566 ± 70 nats worse"),
        _trial("asymmetric_gain(boom)", {"ratio": 1.04}, 49.0, 50.2, 7411.0, "3705 ± 85 nats worse"),
        _trial("backlash(slew, structure)", {"width": 0.01052}, 1.02, 1.01, 0.0, "survives"),
        ComparedModel("joint", "slew", (), {}, 22.4, 23.1, 3120.0, "1560 ± 55 nats worse"),
    )
    return GapResult(
        dataset.reference,
        "autolog@1",
        "autolog@2",
        "named",
        effects,
        (),
        (),
        ("Slew slowly to and fro (20 reversals at |command| < 0.2): the play's side would be certain.",),
        gap,
        gap,
        (
            Excitation("valve_deadband", "boom", True, 41, 8, "slow starts"),
            Excitation("backlash", "stick", False, 4, 20, "reversals"),
        ),
        ("manual-04",),
        12.4,
        tuple(localised),
        candidates,
        (traces,),
        ("Clock of motion capture removed at ingest: −1.2346 s, 42 ppm.",),
        settings={"seed": 0},
        shares=(
            Share("tool", "tool", "tool", 0.12, 0.021, 0.06),
            Share("tool", "command", "boom", 0.7, 0.05, 0.06),
            Share("tool", "command", "slew", 0.185, 0.026, 0.06),
            Share("tool", "end_effector", "ee", -0.005, 0.0004, 0.06),
        ),
        maps=(
            Map(
                "command", "boom", "boom.cylinder", "boom.command", "1", "speed error", "m/s", 1.4e-4, 0.91,
                (-0.6, -0.3, 0.0, 0.3, 0.6), (200, 300, 900, 310, 190), (0.0012, 0.0011, 0.0, -0.0019, -0.002),
                (2e-4,) * 5, (1e-5, 0.0, 0.0, -1e-5, 0.0), (-0.0138, -0.0064, 0.0, 0.0056, 0.013),
                (-0.015, -0.0075, 0.0, 0.0075, 0.015),
            ),
            Map(
                "command", "boom", "boom.cylinder", "direction of boom", "1", "error", "m", 2e-4, 0.32,
                (-1.0, 0.0, 1.0), (700, 500, 800), (0.002, 0.0005, -0.003), (1e-3, 2e-3, 1e-3),
            ),
        ),
    )  # fmt: skip


def _trial(label: str, values: dict[str, float], fit: float, selection: float, bic: float, verdict: str) -> ComparedModel:
    stage, target = ("joint", "slew") if "slew" in label else ("command", "boom")
    return ComparedModel(
        stage, target, (label,), {f"{label}.{key}": v for key, v in values.items()}, fit, selection, bic, verdict
    )


def sample_unnamed(dataset: Dataset) -> GapResult:
    """A result that abstains: structure is left over, two effects tie."""
    result = sample_gap(dataset)
    return replace(
        result,
        verdict="ambiguous",
        effects=(),
        plant_after="autolog@1",
        unnamed=(Unnamed("command", "boom", 0.0012, "boom.cylinder", "0.004 − 0.031·boom.cylinder"),),
        ambiguous=((("valve_hysteresis", "boom"), ("backlash", "boom")),),
    )
