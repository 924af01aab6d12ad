"""``step_axis.m`` of the Simulink export, run by GNU Octave on the commands of the probe, beside the plant."""

from __future__ import annotations

import functools
import shutil
import subprocess
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from test_drive_model import name_of, placed, probe_plant

from sysid.effects import effect_named
from sysid.export.replay import SHARE
from sysid.export.simulink import SimulinkTarget, field_name
from sysid.machine import KnownEffect
from sysid.plant.stepper import Stepper, held_commands, step_commands
from sysid.testing.probe import RATE_HZ, probe_recording

Array = npt.NDArray[np.float64]
OCTAVE = shutil.which("octave-cli")
pytestmark = pytest.mark.skipif(OCTAVE is None, reason="GNU Octave is not installed: step_axis.m is not run")
#: Joints and drives at the start [rad or m].
JOINTS, DRIVES = (0.1, 0.2, 0.0, 0.3), (0.1, 0.05, 0.0, 0.3)
SCRIPT = """
load machine.mat; commands = csvread('commands.csv'); names = {%s}; starts = [%s];
places = zeros(size(commands));
for k = 1:numel(names)
    state = struct('position', starts(k));
    for n = 1:rows(commands)
        [places(n, k), state] = step_axis(machine.(names{k}), commands(n, k), state, machine.sample_time);
    end
end
dlmwrite('places.csv', places, 'precision', 17);
"""


def cells() -> list[object]:
    """Every effect that the target represents, in each of its forms at each of its places."""
    native = [item for item in placed() if SimulinkTarget().support(effect_named(item.name)).kind == "native"]
    return [pytest.param(item, id=name_of(item)) for item in native]


@functools.cache
def commands() -> Array:
    """Of the probe (n, axes), the first held for a second."""
    machine = probe_plant().machine
    found = step_commands(machine, held_commands(machine, probe_recording()))
    return np.concatenate([np.repeat(found[:1], 100, axis=0), found])


def by_octave(folder: Path, axes: list[int]) -> Array:
    """Positions of the drives of some axes (n, len(axes)), from the files of an export."""
    names = [field_name(probe_plant().machine.axis_names[k]) for k in axes]
    np.savetxt(folder / "commands.csv", commands()[:, axes], delimiter=",", fmt="%.17g")
    script = SCRIPT % (", ".join(f"'{name}'" for name in names), ", ".join(str(DRIVES[k]) for k in axes))
    (folder / "run_axes.m").write_text(script, "utf-8")
    assert OCTAVE is not None
    subprocess.run([OCTAVE, "--no-gui", "--quiet", "run_axes.m"], cwd=folder, check=True, capture_output=True, timeout=120)
    return np.loadtxt(folder / "places.csv", delimiter=",", ndmin=2)


def by_plant(*effects: KnownEffect) -> Array:
    """Positions of all drives (n, axes)."""
    stepper = Stepper(probe_plant(*effects), RATE_HZ)
    stepper.reset(np.array(JOINTS), drive=np.array(DRIVES), commands=commands()[0])
    return np.array([stepper.step(command).drive[0].copy() for command in commands()])


@pytest.mark.slow
@pytest.mark.parametrize("item", cells())
def test_a_cell_steps_as_the_plant_does(item: KnownEffect, tmp_path: Path) -> None:
    SimulinkTarget().write(probe_plant(item), RATE_HZ, tmp_path)
    axis = probe_plant().machine.axis_names.index(item.target)
    found, expected = by_octave(tmp_path, [axis])[:, 0], by_plant(item)[:, axis]
    moved = float(np.std(expected))
    assert moved > 1e-4
    assert float(np.sqrt(np.mean((found - expected) ** 2))) <= SHARE * moved


def test_every_axis_alone(tmp_path: Path) -> None:
    """Without effects nothing is interpolated between points of a curve: equal to rounding."""
    SimulinkTarget().write(probe_plant(), RATE_HZ, tmp_path)
    np.testing.assert_allclose(by_octave(tmp_path, [0, 1, 2, 3]), by_plant(), rtol=0.0, atol=1e-9)
