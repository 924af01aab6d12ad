"""Dynamics of the booms against Lagrange's equations by finite differences, and elastic joints."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from simulated_bench import BenchRecipe, RecordingSettings, simulate
from simulated_bench.drivetrain import flex_step
from simulated_bench.hydraulic_recipe import MassSettings
from simulated_bench.machine import run_machine
from simulated_bench.recipe import GripperSettings
from simulated_bench.rigid_body import RigidBodies, bodies_of, energy, equations, rod_force, solve3

Array = npt.NDArray[np.float64]

BODIES = bodies_of(MassSettings(), 0.576, 0.400, 0.0)


def heights_and_speeds(joint: Array, speed: Array, bodies: RigidBodies) -> tuple[float, float]:
    """Kinetic and potential energy from positions alone: velocities by differences along the motion."""

    def places(q: Array) -> list[tuple[float, Array]]:
        e1 = np.array([math.cos(q[1]), math.sin(q[1])])
        e2 = np.array([math.cos(q[1] + q[2]), math.sin(q[1] + q[2])])
        elbow, far = bodies.boom_length * e1, bodies.stick_length + q[3]
        planar = [
            (bodies.boom, bodies.boom_centre * e1),
            (bodies.stick, elbow + bodies.stick_centre * e2),
            (bodies.telescope, elbow + (far + bodies.telescope_centre) * e2),
            (bodies.hanging, elbow + far * e2),
        ]
        return [(m, np.array([p[0] * math.cos(q[0]), p[0] * math.sin(q[0]), p[1]])) for m, p in planar]

    h = 1e-5
    moving = 0.0
    for (m, before), (_, after) in zip(places(joint - h * speed), places(joint + h * speed), strict=True):
        moving += 0.5 * m * float(np.sum(((after - before) / (2 * h)) ** 2))
    outer = bodies.stick_inertia + bodies.telescope_inertia
    c1, c2 = math.cos(joint[1]), math.cos(joint[1] + joint[2])
    moving += 0.5 * (bodies.column_inertia + bodies.boom_inertia * c1**2 + outer * c2**2) * speed[0] ** 2
    moving += 0.5 * bodies.boom_inertia * speed[1] ** 2 + 0.5 * outer * (speed[1] + speed[2]) ** 2
    return moving, 9.81 * sum(m * p[2] for m, p in places(joint))


def test_equations_are_those_of_lagrange() -> None:
    """d/dt(∂T/∂q̇) − ∂T/∂q + ∂V/∂q, all by differences of an energy written down apart, at random states."""
    rng = np.random.default_rng(4)
    mass, bias, weight = np.empty((3, 3)), np.empty(3), np.empty(3)
    half = 0.5 * np.eye(4)
    for _ in range(20):
        q = rng.uniform([-2.0, -0.4, -2.5, 0.0], [2.0, 1.3, -0.2, 0.25])
        v = rng.uniform(-1.5, 1.5, 4)
        a = rng.uniform(-3.0, 3.0, 4)
        around, rate = equations(q, v, BODIES, mass, bias, weight)
        ours = np.empty(4)
        ours[0] = around * a[0] + rate * v[0]
        ours[1:] = mass @ a[1:] + bias + weight

        def momentum(q: Array, v: Array) -> Array:
            # Kinetic energy is quadratic in the speeds: a wide difference is exact.
            return np.array([heights_and_speeds(q, v + e, BODIES)[0] - heights_and_speeds(q, v - e, BODIES)[0] for e in half])

        h = 1e-4
        changing = (momentum(q + h * v, v + h * a) - momentum(q - h * v, v - h * a)) / (2 * h)
        slope = np.empty(4)
        for i, e in enumerate(1e-5 * np.eye(4)):
            up, down = heights_and_speeds(q + e, v, BODIES), heights_and_speeds(q - e, v, BODIES)
            slope[i] = ((up[0] - up[1]) - (down[0] - down[1])) / 2e-5
        assert ours == pytest.approx(changing - slope, abs=1e-4)
        assert energy(q, v, BODIES) == pytest.approx(heights_and_speeds(q, v, BODIES), rel=1e-5)


def test_swinging_mass_is_no_inertia_sideways() -> None:
    mass, bias, weight = np.empty((3, 3)), np.empty(3), np.empty(3)
    q, v = np.array([0.0, 0.0, -0.2, 0.1]), np.zeros(4)
    fixed, _ = equations(q, v, BODIES, mass, bias, weight)
    heavy = weight.copy()
    swinging, _ = equations(q, v, bodies_of(MassSettings(), 0.576, 0.400, 0.22), mass, bias, weight)
    assert weight == pytest.approx(heavy), "its weight stays"
    reach = 0.576 + 0.5 * math.cos(0.2)
    assert fixed - swinging == pytest.approx(3.0 * reach**2)
    assert rod_force(np.array([0.6, 0.01, -0.2]), np.array([0.6, 0.0, 0.0]), 3.0) == pytest.approx((0.0, 3.0 * 9.81 * 0.05))


def test_three_equations_are_solved() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        matrix, right, out = rng.normal(size=(3, 3)) + 3.0 * np.eye(3), rng.normal(size=3), np.empty(3)
        solve3(matrix, right, out)
        assert matrix @ out == pytest.approx(right, abs=1e-9)


def test_elastic_joint_swings_at_its_frequency_and_comes_to_rest_where_its_weight_says() -> None:
    stiffness, inertia, moment, damping = 2e4, 8.0, 85.0, 0.05
    x, rate, path = 0.0, 0.0, []
    for _ in range(20_000):
        x, rate = flex_step(x, rate, 0.0, moment, inertia, stiffness, damping, 1e-3)
        path.append(x)
    assert path[-1] == pytest.approx(-moment / stiffness, rel=1e-9)
    coarse, rate = 0.0, 0.0
    for _ in range(10):
        coarse, rate = flex_step(coarse, rate, 0.0, moment, inertia, stiffness, damping, 1e-2)
    assert coarse == pytest.approx(path[99], rel=1e-9), "exact, whatever the step"
    signs = np.array(path[:2000]) > -moment / stiffness
    period = 1e-3 * np.diff(np.flatnonzero(~signs[:-1] & signs[1:])).mean()
    expected = 2.0 * math.pi / (math.sqrt(stiffness / inertia) * math.sqrt(1.0 - damping**2))
    assert period == pytest.approx(expected, rel=0.01)


def test_boom_sags_a_quarter_of_a_degree_at_full_reach(recipe: BenchRecipe) -> None:
    """2e4 N·m/rad: 0.25°, 5 mm at 1.23 m."""
    parks = {"boom": 0.0, "stick": -0.11, "telescope": 0.249}
    axes = {name: replace(axis, park=parks.get(name, axis.park)) for name, axis in recipe.axes.items()}
    elastic = {**axes, "boom": replace(axes["boom"], stiffness=2e4)}
    recording = RecordingSettings("still", seed=1, seconds=2.0)
    stiff = run_machine(replace(recipe, axes=axes), recording, np.random.default_rng(0))
    soft = run_machine(replace(recipe, axes=elastic), recording, np.random.default_rng(0))
    sag = np.rad2deg(stiff.joint[:, 1] - soft.joint[:, 1])
    assert sag == pytest.approx(0.25, abs=0.02)
    assert np.ptp(sag) < 1e-8, "at rest from the start"
    assert 1e3 * (stiff.ee[0, 2] - soft.ee[0, 2]) == pytest.approx(5.3, abs=0.5)
    assert (stiff.drive == soft.drive).all()


def test_stiff_structure_is_the_rigid_one(recipe: BenchRecipe) -> None:
    axes = {name: replace(axis, stiffness=1e9) for name, axis in recipe.axes.items()}
    recording = replace(recipe.recording("manual-02"), seconds=15.0)
    rigid = run_machine(recipe, recording, np.random.default_rng(1))
    hard = run_machine(replace(recipe, axes=axes), recording, np.random.default_rng(1))
    assert np.abs(hard.joint - rigid.joint).max() < 1e-5


def test_bodies_are_created_on_the_sagged_machine(recipe: BenchRecipe) -> None:
    """The reference pose is what it really is, so the boom tip is where its body says."""
    boom = replace(recipe.axis("boom"), stiffness=2e4)
    capture = replace(recipe.capture, noise=0.0, dropouts_per_minute=0.0, swaps=(), exported_markers=())
    machine = replace(recipe, axes={**recipe.axes, "boom": boom}, capture=capture, gripper=GripperSettings())
    run = simulate(machine, RecordingSettings("still", seed=1, seconds=3.0))
    parked = next(body for body in run.capture.bodies if body.name == "boom_body")
    assert parked.quaternion[0] == pytest.approx([0.0, 0.0, 0.0, 1.0], abs=1e-7)
