"""The arm of geared motors of the simulated test bench: friction of every joint and a payload, by their names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from simulated_bench.joint_machines import write_joint_machine
from simulated_bench.joint_recipe import Take
from simulated_bench.torque_arm import Motor, TorqueArm
from sysid.datasets import ingest
from sysid.gap import GapResult, find_gap
from sysid.plant import nominal_plant

pytest.importorskip("pinocchio", reason="the extra dynamics is not installed")

ARM = TorqueArm(
    "torque_arm",
    "arm",
    7,
    (
        Motor("column", (-2.5, 2.5), 0.4, 6.0, rotor=0.9, constant=12.0, coulomb=6.0, viscous=9.0),
        Motor("shoulder", (-0.4, 1.8), 0.5, 5.0, rotor=0.9, constant=12.0, coulomb=8.0, viscous=11.0),
        Motor("elbow", (-2.2, 0.4), 0.4, 3.0, rotor=0.4, constant=8.0, coulomb=3.5, viscous=4.0),
    ),
    tuple(Take(f"motion-{k}", k, 30.0) for k in range(1, 5)),
    noise=2e-5,
    current_noise=0.02,
)
FRICTION = {(name, motor.name) for name in ("coulomb_friction", "viscous_friction") for motor in ARM.axes}
RECIPE = """schema = 1
name = "arm"
machine = "machine.toml"
logs = "logs"
[splits]
fit = ["motion-1", "motion-2"]
select = ["motion-3"]
held_out = ["motion-4"]
[[streams]]
files = "*.csv"
time = "time"
[streams.signals]
"""


def found(folder: Path, payload: float) -> GapResult:
    write_joint_machine(replace(ARM, payload=payload), folder / "logs")
    for path in (*(folder / "logs").glob("*.toml"), *(folder / "logs").glob("*.urdf")):
        path.rename(folder / path.name)
    lines = [f'"{m.name}.command" = {{ field = "{m.name}.current", scale = {m.constant}, unit = "N·m" }}' for m in ARM.axes]
    lines += [f'"{m.name}.joint" = {{ field = "{m.name}.joint", unit = "rad" }}' for m in ARM.axes]
    (folder / "recipe.toml").write_text(RECIPE + "\n".join(lines) + "\n", "utf-8")
    dataset = ingest([folder], folder / "workspace")
    return find_gap(dataset, nominal_plant(dataset.machine))


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_friction_of_every_joint_and_the_payload_are_named(tmp_path: Path) -> None:
    result = found(tmp_path, 3.0)
    assert {(e.name, e.target) for e in result.effects} == {*FRICTION, ("payload", "tool")}
    values = {(e.name, e.target): e for e in result.effects}
    assert values["payload", "tool"].parameters["mass"] == pytest.approx(3.0, rel=0.03)
    for motor in ARM.axes:
        assert values["coulomb_friction", motor.name].parameters["force"] == pytest.approx(motor.coulomb, rel=0.02)
        assert values["viscous_friction", motor.name].parameters["coefficient"] == pytest.approx(motor.viscous, rel=0.02)
        assert values["viscous_friction", motor.name].units == {"coefficient": "N·m·s/rad"}


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_rotor_gets_no_name_for_what_an_adjusted_link_has_too_much(tmp_path: Path) -> None:
    """A payload that wrong masses could be is adjusted as errors of the links, which share their inertia with the rotors."""
    result = found(tmp_path, 1.4)
    assert {(e.name, e.target) for e in result.effects} - {("payload", "tool")} == FRICTION
