"""The cylinder controller: it undoes the valve, keeps limits, and follows what a plain one does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from crane_model import crane_plant
from plant_data import slide

from sysid.errors import InputError, SettingsError
from sysid.machine import KnownEffect
from sysid.plant import Plant, nominal_plant
from sysid.plant.stepper import Stepper
from sysid_rl.control import AxisTuning, CylinderController, proportional_tuning, response_time, tune

Array = npt.NDArray[np.float64]
PLANT = crane_plant(
    KnownEffect("valve_deadband", "boom", {"positive": 0.12, "negative": 0.10}),
    KnownEffect("asymmetric_gain", "stick", {"ratio": 1.4}),
    KnownEffect("backlash", "slew", {"width": 0.0105}, "drive"),
)
BEGIN = np.array([0.0, 0.4, -1.2, 0.12])


def follow(
    plant: Plant, path: Array, tuning: tuple[AxisTuning, ...] | None = None, preview: float = 0.0
) -> tuple[Array, Array]:
    """Joints (n, A) and commands (n, A) while the setpoint of step k is row k + 1 (+ preview) of ``path``."""
    stepper, controller = Stepper(plant, 100.0), CylinderController(plant, tuning, preview=preview)
    lane = stepper.reset(path[0])
    controller.reset(np.where(controller.cylinders, lane.drive, lane.joints))
    joints, commands = np.empty((len(path) - 1, 4)), np.empty((len(path) - 1, 4))
    ahead = round(100.0 * preview)
    for k in range(len(path) - 1):
        measured = np.where(controller.cylinders, lane.drive, lane.joints)
        commands[k] = controller.commands(path[min(k + 1 + ahead, len(path) - 1)], measured)[0]
        lane = stepper.step(commands[k])
        joints[k] = lane.joints[0]
    return joints, commands


def waves(seconds: float = 20.0) -> Array:
    """All joints swing slowly from rest."""
    time = np.arange(round(100.0 * seconds)) / 100.0
    swing = np.array([0.25, 0.12, 0.2, 0.05])
    return BEGIN + swing * (0.5 - 0.5 * np.cos(2.0 * np.pi * 0.1 * time))[:, None]


def test_tuned_it_follows_and_untuned_it_does_not() -> None:
    path = waves()
    span = np.ptp(path, axis=0)
    tuned, _ = follow(PLANT, path)
    untuned, _ = follow(PLANT, path, proportional_tuning(PLANT))
    error, worse = (np.sqrt(np.mean((joints - path[1:]) ** 2, axis=0)) / span for joints in (tuned, untuned))
    assert (error < 0.015).all()
    assert (worse > 8.0 * error).all()


def test_with_preview_the_dead_time_is_gone() -> None:
    path = waves()
    now, _ = follow(PLANT, path)
    ahead, _ = follow(PLANT, path, preview=0.11)
    error, less = (np.sqrt(np.mean((joints - path[1:]) ** 2, axis=0)) for joints in (now, ahead))
    assert (less < 0.8 * error).all()
    assert less[3] < 0.4 * error[3]


def test_the_dead_band_is_undone_on_both_sides() -> None:
    boom = tune(PLANT)[1]
    assert (boom.positive, boom.negative) == (0.12, 0.10)
    for speed, band in ((0.010, 0.12), (-0.010, -0.10)):
        _, commands = follow(PLANT, BEGIN + np.outer(np.arange(100) / 100.0, [0.0, 0.1 * np.sign(speed), 0.0, 0.0]))
        rate = np.median(commands[20:, 1])
        assert np.sign(rate) == np.sign(band)
        assert abs(rate) > abs(band)


def test_the_inverse_of_the_valve_gives_the_speed_that_is_asked_for() -> None:
    plant = crane_plant(
        KnownEffect("asymmetric_gain", "stick", {"ratio": 1.4}), KnownEffect("gain_curve", "stick", {"exponent": 1.3})
    )
    stick = tune(plant)[2]
    assert (stick.up, stick.down, stick.exponent) == pytest.approx((0.035, 0.049, 1.3))
    for speed in (0.012, -0.012):
        stepper = Stepper(plant, 100.0)
        middle = BEGIN.copy()
        lane = stepper.reset(middle)
        controller = CylinderController(plant, [replace(item, proportional=0.0, integral=0.0) for item in tune(plant)])
        controller.reset(np.where(controller.cylinders, lane.drive, lane.joints))
        drive = lane.drive.copy()
        places = []
        for _ in range(100):
            drive[0, 2] += speed / 100.0
            joints = middle.copy()
            joints[2] = plant.linkages["stick"].joint(drive[:, 2])[0]
            lane = stepper.step(controller.commands(joints, np.where(controller.cylinders, lane.drive, lane.joints)))
            places.append(lane.drive[0, 2])
        assert (places[-1] - places[50]) / (0.01 * (99 - 50)) == pytest.approx(speed, rel=0.01)


def test_commands_stay_in_range_and_rate_and_nothing_winds_up() -> None:
    jump = np.tile(BEGIN, (1500, 1))
    jump[100:700, 0] += 1.5
    joints, commands = follow(PLANT, jump)
    assert np.abs(commands).max() <= 1.0
    assert np.abs(np.diff(commands, axis=0)).max() <= 0.4 + 1e-12
    assert np.abs(commands[150:250, 0]).max() == 1.0
    overshoot = joints[100:700, 0].max() - 1.5
    assert overshoot < 0.03
    assert abs(joints[-1, 0]) < 0.01


def test_setpoints_beyond_the_stroke_are_cut() -> None:
    path = np.tile(BEGIN, (600, 1))
    path[10:, 1] = 5.0
    _, commands = follow(PLANT, path)
    assert abs(commands[-1, 1]) < 0.15  # it stands at the end of the stroke and is not pushed on


def test_at_rest_nothing_chatters() -> None:
    _, commands = follow(PLANT, np.tile(BEGIN, (300, 1)))
    assert np.abs(commands).max() < 1e-4


def test_a_noisy_sensor_opens_no_valve_while_a_setpoint_stands() -> None:
    """Nor the way across the backlash: noise has either sign, and would ask for it to and fro."""
    rng = np.random.default_rng(0)
    tuning = tune(PLANT)
    controller = CylinderController(PLANT, tuning)
    drive = controller.drive(BEGIN)[0]
    controller.reset(drive)
    noise = np.array([5e-4, 2e-5, 2e-5, 2e-5])
    commands = np.array([controller.commands(BEGIN, drive + noise * rng.standard_normal(4))[0] for _ in range(500)])
    bands = np.array([[item.positive, item.negative] for item in tuning])
    assert (commands <= bands[:, 0] + 0.02).all()
    assert (-commands <= bands[:, 1] + 0.02).all()


def test_copies_are_the_same_as_one_machine_and_resume_exactly() -> None:
    rng = np.random.default_rng(0)
    setpoints = BEGIN + 0.05 * rng.standard_normal((30, 3, 4))
    many = CylinderController(PLANT, copies=3, preview=0.07)
    single = CylinderController(PLANT, preview=0.07)
    begin = many.drive(BEGIN)[0]
    many.reset(begin)
    single.reset(begin)
    for k, rows in enumerate(setpoints):
        measured = np.tile(begin, (3, 1)) + 1e-3 * rng.standard_normal((3, 4))
        out = many.commands(rows, measured)
        np.testing.assert_array_equal(out[1], single.commands(rows[1], measured[1])[0])
        if k == 15:
            state = many.state()
            many.reset(begin)
            many.restore(state)


def test_a_servo_gets_its_setpoint() -> None:
    from plant_data import arm

    plant = nominal_plant(arm())
    controller = CylinderController(plant)
    controller.reset(controller.drive(np.array([0.0, 0.3, 0.1]))[0])
    assert controller.commands([0.0, 0.3, 0.4], controller.drive([0.0, 0.3, 0.1])[0])[0, 2] == 0.4


def test_the_gains_follow_from_the_dead_time() -> None:
    slew = tune(PLANT)[0]
    dead = 0.0417 + 0.062 + 0.005
    assert slew.proportional == pytest.approx(1.0 / (2.0 * dead))
    assert slew.integral == pytest.approx(slew.proportional / (8.0 * dead))
    assert response_time(PLANT) == pytest.approx(0.0417 + 0.062)


def test_mistakes_are_named() -> None:
    with pytest.raises(SettingsError, match=r"axis slide: is moved by force; expected a velocity \(valve\) or position axis"):
        tune(nominal_plant(slide()))
    with pytest.raises(SettingsError, match=r"preview = 9\.0 s; expected 0 to 5 s"):
        CylinderController(PLANT, preview=9.0)
    with pytest.raises(SettingsError, match="axis boom has no linkage"):
        CylinderController(replace(PLANT, linkages={}))
    controller = CylinderController(PLANT)
    with pytest.raises(InputError, match="a copy was never reset"):
        controller.commands(BEGIN, BEGIN)
    controller.reset(controller.drive(BEGIN)[0])
    with pytest.raises(InputError, match="setpoints with a value that is not finite"):
        controller.commands([np.nan, 0.0, 0.0, 0.0], BEGIN)
    with pytest.raises(InputError, match=r"measured of shape \(1, 3\); expected \(1, 4\)"):
        controller.commands(BEGIN, BEGIN[:3])
