"""Sensor errors of a position axis that sag under its known load replaces: over a small range of a pendulum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from sysid.datasets import Dataset, Recording
from sysid.gap import find_gap, steps
from sysid.gap.arm.sag_ties import sag_replaces
from sysid.gap.fit import Fit
from sysid.gap.stage_result import StageResult
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import nominal_plant

RATE, NOISE, WEIGHT = 50.0, 3e-4, 0.5
URDF = """<robot name="pendulum"><link name="base"/>
<link name="arm"><inertial><origin xyz="0 0 -0.1"/><mass value="{mass}"/></inertial></link><link name="bob"/>
<joint name="arm_joint" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="{axis}"/>
<limit lower="-3" upper="3" effort="1" velocity="9"/></joint>
<joint name="bob_joint" type="fixed"><parent link="arm"/><child link="bob"/><origin xyz="0 0 -0.1"/></joint></robot>"""
MACHINE = f"""schema = 1
name = "pendulum"
rate_hz = {RATE}
urdf = "pendulum.urdf"
tip = "bob"
[[axes]]
name = "arm"
joint = "arm_joint"
actuation = "position"
drives = "joint"
[noise]
"arm.joint" = {NOISE}
"""


def recording(name: str, seed: int, reach: float, compliance: float, friction: float) -> Recording:
    """A pendulum that hangs at zero; its servo sags, and stops short of its position in the direction of motion by friction."""
    draw = np.random.default_rng(seed)
    time = np.arange(round(30.0 * RATE)) / RATE
    setpoint = reach * sum(np.sin(w * time + draw.uniform(0.0, 6.28)) for w in (0.9, 1.7, 2.9)) / 2.0
    q = setpoint.copy()
    for _ in range(200):
        q = 0.5 * q + 0.5 * (setpoint - compliance * WEIGHT * np.sin(q))
    q -= friction * np.sign(np.gradient(q))
    table = {"time": time, "arm.command": setpoint, "arm.joint": q + NOISE * draw.standard_normal(len(time))}
    return Recording(name, pd.DataFrame(table), RATE)


def dataset(reach: float, compliance: float = 1.6, friction: float = 0.0, axis: str = "0 -1 0") -> Dataset:
    urdf = URDF.format(mass=WEIGHT / (9.80665 * 0.1), axis=axis)
    machine = machine_from_files({"machine.toml": MACHINE, "pendulum.urdf": urdf}, "pendulum")
    roles = {"one": "fit", "two": "select", "three": "held_out"}
    runs = tuple(recording(name, k, reach, compliance, friction) for k, name in enumerate(roles))
    return Dataset.of(machine, runs, roles)  # type: ignore[arg-type]


def replaces(data: Dataset, effect: KnownEffect, left: float) -> bool:
    """The comparison for a stage that has found a sensor error and leaves so many noise floors."""
    plant = nominal_plant(data.machine)
    study = steps.open_study(data, plant)
    (stage,) = study.stages
    theta = plant.with_effect(effect).vector()
    fit = Fit((), (), np.empty(0), theta)
    return sag_replaces(study.case, replace(stage, result=StageResult(stage.problem, (), (), fit, 1.0, left)))


SCALE = KnownEffect("sensor_scale", "arm.joint", {"scale": 0.55})
BIAS = KnownEffect("sensor_bias", "arm.joint", {"bias": 0.2})


@pytest.mark.parametrize(
    ("reach", "effect", "left", "expected"),
    [
        (0.8, SCALE, 100.0, True),
        (0.8, SCALE, 1.0, False),
        (3.0, SCALE, 100.0, False),
        (0.8, BIAS, 100.0, False),
    ],
    ids=["small range", "small range, nothing else unexplained", "large range", "constant error"],
)
def test_where_the_load_varies_as_the_error_does(reach: float, effect: KnownEffect, left: float, expected: bool) -> None:
    assert replaces(dataset(reach), effect, left) is expected


def test_an_axis_without_load_has_no_sag() -> None:
    assert not replaces(dataset(0.8, axis="0 0 1"), SCALE, 1000.0)


@pytest.mark.slow
def test_a_servo_that_sags_beside_friction_gets_no_sensor_error() -> None:
    """Friction of a weak servo leaves more than what distinguishes the sine of an angle from the angle."""
    data = dataset(0.8, friction=0.03)
    found = find_gap(data, nominal_plant(data.machine))
    assert not [e for e in found.effects if e.name.startswith("sensor_")]
    assert found.ambiguous == ((("sensor_scale", "arm.joint"), ("joint_compliance", "arm")),)
