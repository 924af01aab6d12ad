"""``sysid init`` lays out folders that the rest of the toolkit accepts."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from command_line import run

from sysid.cli.init import KINDS
from sysid.datasets import Store
from sysid.datasets.recipe import load_recipe
from sysid.machine import load_machine
from sysid.plant import nominal_plant

Floats = npt.NDArray[np.float64]


def test_layout_is_valid_as_it_stands(tmp_path: Path) -> None:
    assert run("init", tmp_path / "My Crane", "--json", tmp_path / "made.json") == 0
    folder = tmp_path / "My Crane" / "datasets" / "my-crane"
    machine = load_machine(folder / "machine.toml")
    recipe = load_recipe(folder / "recipe.toml")
    assert recipe.name == "my-crane"
    assert machine.name == "my-crane"
    assert machine.axis("boom").driven == "boom.cylinder"
    assert {path.name for path in (tmp_path / "My Crane").iterdir()} == {"datasets", "pipelines", "rl", "reports", ".gitignore"}
    made = json.loads((tmp_path / "made.json").read_text())
    assert f"datasets/{machine.name}/recipe.toml" in made["made"]
    assert {axis.actuation for axis in machine.axes} == {"velocity"}, "what no --kind means: hydraulic"


def test_what_is_commented_out_in_a_template_is_valid_too(kind: str, tmp_path: Path) -> None:
    """Every key that a template offers in a comment exists, and every line with a key has a comment that explains it."""
    run("init", tmp_path, "--name", "arm", "--kind", kind)
    folder = tmp_path / "datasets" / "arm"
    for file in ("machine.toml", "recipe.toml"):
        lines = (folder / file).read_text("utf-8").splitlines()
        seen = set()
        for line in lines:
            key = re.match(r'(?:# )?([\w"<>.]+) = |(?:# )?(\[+[\w.]+\]+)', line)
            if key is not None and (name := key[1] or key[2]) not in seen:
                assert re.search(r"[^#\s].*#|^# .*#", line), f"{file}: {line}"
                seen.add(name)
        (folder / file).write_text("\n".join(re.sub(r'^# (?=[\w"]+ = |"|\[)', "", line) for line in lines), "utf-8")
    joints = [axis["name"] for axis in tomllib.loads((folder / "machine.toml").read_text("utf-8"))["axes"]]
    (folder / "arm.urdf").write_text(urdf(joints, folder / "machine.toml"), "utf-8")
    text = (folder / "machine.toml").read_text("utf-8")
    for joint in joints[1:]:  # the template explains each key once, at the first axis
        text = text.replace(f'name = "{joint}"\n', f'name = "{joint}"\njoint = "{joint}_joint"\n')
    (folder / "machine.toml").write_text(text, "utf-8")
    machine = load_machine(folder / "machine.toml")
    assert machine.effects
    nominal_plant(machine)  # the effect and its parameters are of the catalogue
    assert load_recipe(folder / "recipe.toml").splits.held_out == ("day-3-*",)


def urdf(axes: list[str], machine: Path) -> str:
    """A chain of one revolute joint an axis, with the links that the template names."""
    values = tomllib.loads(machine.read_text("utf-8"))
    links = ["base", *axes[:-1], values["tip"], *([values["tool"]] if "tool" in values else [])]
    parts = ["".join(f'<link name="{link}"/>' for link in links)]
    for parent, child, axis in zip(links, links[1:], [*axes, "tool"], strict=False):
        kind = "fixed" if axis == "tool" else "revolute"
        parts.append(
            f'<joint name="{axis}_joint" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            '<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        )
    return f'<robot name="arm">{"".join(parts)}</robot>'


RATE_HZ = 50.0


def held_commands(rng: np.random.Generator, seconds: float) -> Floats:
    """A new random command between -1 and 1 every second, each tenth of them zero."""
    steps = rng.uniform(-1.0, 1.0, int(seconds)) * (rng.random(int(seconds)) > 0.1)
    return np.repeat(steps, int(RATE_HZ))


def servo_log(rng: np.random.Generator) -> dict[str, Floats]:
    """Two servos that follow their setpoint with a lag of 80 ms; a row is a command and the position a cycle later."""
    columns = {"time": np.arange(3000) / RATE_HZ}
    for axis in ("shoulder", "elbow"):
        command = held_commands(rng, 60.0)
        joint = np.zeros(3000)
        for i in range(1, 3000):
            joint[i] = command[i] + (joint[i - 1] - command[i]) * np.exp(-1.0 / (RATE_HZ * 0.080))
        columns |= {f"{axis}.command": command, f"{axis}.joint": joint + rng.normal(0.0, 5e-4, 3000)}
    return columns


def hydraulic_log(rng: np.random.Generator) -> dict[str, Floats]:
    """Two valves with a dead-band of 0.15 on either side, and cylinders that move at ``gain`` times the rest of the command."""
    columns = {"time": np.arange(4000) / RATE_HZ}
    for axis, gain in (("boom", 0.05), ("stick", 0.06)):
        command, length = held_commands(rng, 80.0), np.full(4000, 0.25)
        for i in range(1, 4000):
            if not 0.1 < length[i - 1] < 0.4:  # the operator turns back
                command[i - 1] = np.copysign(command[i - 1], 0.25 - length[i - 1])
            opening = np.copysign(max(0.0, abs(command[i - 1]) - 0.15), command[i - 1])
            length[i] = length[i - 1] + gain * opening / RATE_HZ
        columns |= {f"{axis}.command": command, f"{axis}.cylinder": length + rng.normal(0.0, 1e-4, 4000)}
    return columns


def force_log(rng: np.random.Generator) -> dict[str, Floats]:
    """A mass of 10 kg on a slide with viscous friction of 30 N·s/m, semi-implicit Euler of 0.1 ms, logged at 500 Hz."""
    fine, each = 1e-4, 20
    time = np.arange(20 * 500 * each) * fine
    force = sum(20.0 * np.sin(2.0 * np.pi * f * time + rng.uniform(0.0, 6.28)) for f in (0.5, 0.8, 1.3))
    position = speed = 0.0
    logged = np.empty(20 * 500)
    for k in range(len(time)):
        if k % each == 0:
            logged[k // each] = position
        speed += fine * (force[k] - 30.0 * speed) / 10.0
        position += fine * speed
    return {"time": time[::each], "slide.command": force[::each], "slide.joint": logged + rng.normal(0.0, 2e-6, len(logged))}


#: Kind → its log, what is missing from the template's simulation of that machine, on which axes, and the true value.
MACHINES = {
    "servo": (servo_log, "first_order_lag", {"shoulder": 0.080, "elbow": 0.080}),
    "hydraulic": (hydraulic_log, "valve_deadband", {"boom": 0.15, "stick": 0.15}),
    "force": (force_log, "viscous_friction", {"slide": 30.0}),
}


@pytest.fixture(scope="module", params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def ingested(kind: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace: a folder of ``kind`` with three recordings, ingested with its templates as they are."""
    place = tmp_path_factory.mktemp(kind)
    assert run("init", place / "mine", "--kind", kind) == 0
    folder = place / "mine" / "datasets" / "mine"
    for day in (1, 2, 3):
        (folder / "logs" / f"day-{day}").mkdir()
        table = pd.DataFrame(MACHINES[kind][0](np.random.default_rng(day)))
        table.to_csv(folder / "logs" / f"day-{day}" / "log.csv", index=False, float_format="%.9g")
    assert run("--workspace", place / "ws", "ingest", folder) == 0
    return place / "ws"


def test_logs_in_the_laid_out_folder_are_ingested_as_the_templates_stand(kind: str, ingested: Path, tmp_path: Path) -> None:
    dataset = Store(ingested).load("mine")
    assert list(dataset.splits.values()) == ["fit", "select", "held_out"]
    _, _, missing = MACHINES[kind]
    assert run("--workspace", ingested, "gap", "mine", "--localise", "--json", tmp_path / "where.json") == 0
    stages = {stage["signal"]: stage for stage in json.loads((tmp_path / "where.json").read_text())["localised"]}
    for axis in missing:
        driven = dataset.machine.axis(axis).driven
        signal = driven if kind != "force" else f"{axis}.command"
        assert np.isfinite(dataset.recordings[0].values(driven)).mean() > 0.99
        assert stages[signal]["stage_rmse"] > 10.0 * stages[signal]["noise_floor"], "what the template's simulation lacks shows"


@pytest.mark.parametrize(
    "kind", ["servo", *(pytest.param(kind, marks=pytest.mark.slow) for kind in KINDS if kind != "servo")], indirect=True
)
def test_a_laid_out_machine_gets_its_effect_named(kind: str, ingested: Path, tmp_path: Path) -> None:
    assert run("--workspace", ingested, "gap", "mine", "--json", tmp_path / "gap.json") == 0
    _, name, missing = MACHINES[kind]
    effects = json.loads((tmp_path / "gap.json").read_text())["effects"]
    assert {(effect["name"], effect["target"]) for effect in effects} == {(name, axis) for axis in missing}
    for effect in effects:
        for value in effect["parameters"].values():
            assert value == pytest.approx(missing[effect["target"]], rel=0.05)


def test_headers_with_another_unit_are_not_read_in_the_unit_of_the_template(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("init", tmp_path / "mine", "--kind", "servo")
    folder = tmp_path / "mine" / "datasets" / "mine"
    table = pd.DataFrame(servo_log(np.random.default_rng(1)))
    table.columns = [name if name == "time" else f"{name} [deg]" for name in table.columns]
    table.to_csv(folder / "logs" / "day.csv", index=False)
    assert run("--workspace", tmp_path / "ws", "ingest", folder) == 2
    said = capsys.readouterr().err
    assert "the file states [deg]" in said
    assert "`unit`" in said


def test_a_second_run_changes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run("init", tmp_path / "crane")
    path = tmp_path / "crane" / "datasets" / "crane" / "machine.toml"
    path.write_text(path.read_text() + "# mine\n")
    capsys.readouterr()
    assert run("init", tmp_path / "crane") == 0
    assert path.read_text().endswith("# mine\n")
    assert "made" not in capsys.readouterr().out


def test_a_name_that_cannot_be_a_folder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("init", tmp_path, "--name", "../x") == 2
    assert "lower-case letters" in capsys.readouterr().err
