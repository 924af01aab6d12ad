"""The cards that ship: complete, readable on 80 columns, and the same values in every file that is exported from them."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import run

from sysid.actuators import ActuatorCard, card_named, card_names
from sysid.actuators.card import card_from
from sysid.actuators.export import CARD, ISAACLAB, MJCF, export_card, joint_values
from sysid.errors import SettingsError
from sysid.export.drive_data import effect_slots
from sysid.export.export import PAGE, target_named
from sysid.export.posterior import RANGES, SAMPLES

CARDS = card_names()
#: The cards of this release.
EXPECTED = {
    "ak80-6-drives",
    "dynamixel-xl330",
    "emps-drive",
    "feetech-sts3215",
    "rc-excavator-valves",
    "ur10e-joints",
}


def test_the_cards_ship() -> None:
    assert set(CARDS) == EXPECTED


@pytest.mark.parametrize("name", CARDS)
def test_a_card_is_complete(name: str) -> None:
    card = card_named(name)
    assert card.name == name
    assert all((card.title, card.data.source, card.data.licence, card.default, card.data.conditions))
    assert len(card.data.digest) == 64
    assert card.data.seconds > 10.0
    assert set(card.data.held_out) <= set(card.data.recordings)
    assert all((Path(__file__).parents[2] / "datasets" / folder).is_dir() for folder in [card.data.recipe.split("/")[1]])
    assert {"command", "commit", "versions", "date", "plant"} <= card.made.keys()
    assert card.not_shown
    assert card.values
    assert card.repeated
    assert card.replays
    for item in card.values:
        assert item.kind != "adjusted" or item.why
        for key, ends in item.interval95.items():
            low, value, high = (np.asarray(x, dtype=np.float64) for x in (ends[0], item.parameters[key], ends[1]))
            assert ((low <= value) & (value <= high)).all(), (item.name, item.target, key)


@pytest.mark.parametrize("name", CARDS)
def test_a_card_predicts_better_than_its_default(name: str) -> None:
    for error in card_named(name).errors:
        assert 0.0 < error.noise_floor <= error.card < error.default


@pytest.mark.parametrize("name", CARDS)
def test_the_plant_of_a_card_has_its_values(name: str) -> None:
    card = card_named(name)
    assert card.axes
    for item in card.values:
        known = card.model.effect(item.name, item.target, item.side)
        assert known is not None
        assert {key: known.parameters[key] for key in item.parameters} == dict(item.parameters)
    assert len(card.model.uncertainty.places) > 0
    assert card.model.origin["dataset_digest"] == card.data.digest


def test_a_replayed_export_has_the_error_of_its_plant() -> None:
    """The whole export of every card, in MuJoCo on the recordings that were held out."""
    for name in CARDS:
        whole = card_named(name).replays[0]
        assert whole.ratio is not None
        assert whole.ratio < 1.1


def test_an_unknown_card_is_refused_with_the_nearest() -> None:
    with pytest.raises(SettingsError, match=r"no card 'emps-drve'.*'emps-drive'"):
        card_named("emps-drve")
    assert run("gap", "arm", "--card", "emps-drve") == 2


def test_a_card_with_an_unknown_key_is_refused() -> None:
    content = card_named("emps-drive").to_json()
    with pytest.raises(SettingsError, match="colour"):
        card_from(content | {"colour": "red"}, "a.json")


@pytest.mark.parametrize("args", [(), *((("show", name)) for name in CARDS)], ids=["list", *CARDS])
def test_the_console_has_80_columns(args: tuple[str, ...], capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert run("actuators", *args) == 0
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 80
    shown = CARDS if not args else (args[1],)
    assert all(name in text for name in shown)


def test_the_console_shows_evidence(capsys: Any) -> None:
    assert run("actuators", "show", "emps-drive") == 0
    text = capsys.readouterr().out
    for part in (
        "Dry friction of slide",
        "95 % interval",
        "noise floor",
        "Not shown by these data",
        "datasets/emps/recipe.toml",
    ):
        assert part in text


def test_json_of_the_list(tmp_path: Path) -> None:
    assert run("actuators", "--json", tmp_path / "list.json") == 0
    cards = json.loads((tmp_path / "list.json").read_text("utf-8"))["cards"]
    assert {card["name"] for card in cards} == set(CARDS)


def exported(name: str, target: str, folder: Path) -> ActuatorCard:
    card = card_named(name)
    made = export_card(card, target_named(target), folder / "out")
    assert {path.name for path in (folder / "out").iterdir()} == set(made.files)
    assert made.replay is None
    assert "a card comes without recordings" in (folder / "out" / PAGE).read_text("utf-8")
    assert card_from(json.loads((folder / "out" / CARD).read_text("utf-8")), CARD) == card
    return card


@pytest.mark.parametrize("name", CARDS)
def test_defaults_for_mujoco_have_the_values_of_the_card(name: str, tmp_path: Path) -> None:
    import mujoco

    card = exported(name, "mjcf", tmp_path)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / MJCF))
    for axis in card.axes:
        joint, drive = model.joint(axis), model.actuator(axis)
        for effect, found in (("viscous_friction", joint.damping), ("coulomb_friction", joint.frictionloss)):
            slots = effect_slots(card.model, effect, axis)
            assert found[0] == pytest.approx(0.5 * (slots["positive"] + slots["negative"]) if slots else 0.0)
        about = card.model.machine.axis(axis)
        if about.actuation == "force":
            assert joint.armature[0] == pytest.approx(about.inertia)
        delay = effect_slots(card.model, "input_delay", axis).get("delay", 0.0)
        assert model.actuator_delay[drive.id] == pytest.approx(delay if delay >= 2e-3 else 0.0)
        if axis in card.loops:
            assert drive.gainprm[0] == pytest.approx(card.loops[axis].kp)
            assert drive.biasprm[1] == pytest.approx(-card.loops[axis].kp)
    mujoco.mj_step(model, mujoco.MjData(model), 100)


def test_defaults_say_what_they_lack(tmp_path: Path) -> None:
    exported("rc-excavator-valves", "mjcf", tmp_path)
    text = (tmp_path / "out" / MJCF).read_text("utf-8")
    assert "not here: Valve dead-band of bucket" in text
    assert joint_values(card_named("feetech-sts3215"))["pitch"].kp is None


def test_arguments_for_isaac_lab(tmp_path: Path) -> None:
    card = exported("ur10e-joints", "isaaclab", tmp_path)
    found = json.loads((tmp_path / "out" / ISAACLAB).read_text("utf-8"))["actuators"]
    assert set(found) == set(card.axes)
    elbow = {item.name: item.parameters for item in card.values if item.target == "elbow"}
    assert found["elbow"]["cfg"]["viscous_friction"] == pytest.approx(elbow["viscous_friction"]["coefficient"])
    assert found["elbow"]["cfg"]["dynamic_friction"] == pytest.approx(elbow["coulomb_friction"]["force"])
    assert found["elbow"]["not_here"] == ["Load-dependent friction of elbow"]


@pytest.mark.parametrize("target", ["urdf", "newton", "isaaclab"])
def test_other_targets_take_a_valve(target: str, tmp_path: Path) -> None:
    exported("rc-excavator-valves", target, tmp_path)


def test_urdf_dynamics(tmp_path: Path) -> None:
    card = exported("emps-drive", "urdf", tmp_path)
    values = joint_values(card)["slide"]
    text = (tmp_path / "out" / "robot.urdf").read_text("utf-8")
    assert f'damping="{values.damping!r}" friction="{values.frictionloss!r}"' in text
    assert 'type="prismatic"' in text


def test_ranges_have_correlations(tmp_path: Path) -> None:
    """Dead times too, as far as they were identified: their draws have the covariance of the card."""
    card = exported("feetech-sts3215", "json", tmp_path)
    ranges = json.loads((tmp_path / "out" / RANGES).read_text("utf-8"))
    names = [item["name"] for item in ranges["parameters"]]
    assert "input_delay.pitch.delay" in names
    with (tmp_path / "out" / SAMPLES).open(encoding="utf-8") as file:
        rows = np.array(list(csv.reader(file))[1:], dtype=np.float64)
    known = card.model.uncertainty
    assert rows.shape == (1000, len(known.places))
    at = next(k for k, place in enumerate(known.places) if place.effect == "input_delay" and place.target == "pitch")
    assert np.std(rows[:, at]) == pytest.approx(np.sqrt(known.covariance[at, at]), rel=0.15)
    assert np.abs(np.array(ranges["correlation"]) - np.eye(len(names))).max() > 0.1


def test_export_on_the_command_line(tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "out"
    assert run("export", "actuators/ur10e-joints", "--to", "urdf", "--out", out) == 0
    text = capsys.readouterr().out
    assert "not representable: load_dependent_friction on elbow" in text
    assert "Not replayed: a card comes without recordings" in text
    assert run("export", "emps-drive", "--to", "json", "--out", tmp_path / "b", "--dataset", "arm") == 2
    assert "--dataset arm with a card" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()


def test_the_nearest_card_of_an_unknown_plant(tmp_path: Path, capsys: Any) -> None:
    assert run("--workspace", tmp_path, "export", "emps-drve", "--to", "json", "--out", tmp_path / "out") == 2
    assert "actuators/emps-drive" in capsys.readouterr().err
