"""``unnamed_residual``: a small recurrent network for an error that no effect explains. No physics, bounded output.

Every ``interval`` seconds the network takes commands, position, speed and load of its axis (x) and updates its contribution to
a stage of the chain: ``bound·tanh(w·h + w₀)`` of a long short-term memory (:mod:`sysid.networks.cell`).

It contributes a share of the demanded speed of a velocity axis, so that an axis at rest stays at rest; to the position of a
servo (both ``command``); to the joint behind a cylinder (``joint``); or to the force of a motion (``force``). It is updated at
the beginning of a step, so that the chain stays causal.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from sysid.effects.compiled import inlined, loop
from sysid.errors import SettingsError, StoreError
from sysid.machine import Machine
from sysid.networks import cell
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]
ResidualStage = Literal["command", "joint", "force"]

NAME = "unnamed_residual"
#: Stages that may have one.
STAGES: tuple[ResidualStage, ...] = get_args(ResidualStage)
FILE = "residuals.safetensors"
#: Shown with every residual network.
WARNING = "learned from the recordings, no physics: it does not show the cause and is not valid beyond what was recorded"

# Columns of ``ResidualArrays.about``.
AXIS, STAGE, UNITS, INTERVAL, BOUND, PERIOD = range(6)
# Memory of a network: its contribution, seconds since the last update, the position then; then the state of its cell.
OUTPUT, AGE, LAST_POSITION, STATES = 0, 1, 2, 3


class ResidualArrays(NamedTuple):
    """All residual networks of a plant as flat arrays, (R, …); see :class:`Residual`."""

    about: Array
    mean: Array
    scale: Array
    weights: Array


class StageResidual(NamedTuple):
    """The network of one stage for a run of its axis alone: ``commands`` (n, A) during each step, memory (M,)."""

    nets: ResidualArrays
    row: int
    commands: Array
    memory: Array


@dataclass(frozen=True, eq=False)
class Residual:
    """A trained network at one stage of one axis.

    Args:
        bound: largest contribution: share of the speed, or position, angle, force.
        interval: seconds between two updates.
        period: of a ripple over the position, whose sine and cosine are inputs. Zero for none.
        mean, scale: of the inputs, ``x = clip((value − mean)·scale, ±REACH)``; a scale of zero leaves an input out, (F,).
        W, U, b: of the gates, (4H, F), (4H, H), (4H,).
        w, w0: of the output, (H,), (1,).
        origin: lineage of its training.
    """

    stage: ResidualStage
    target: str
    bound: float
    interval: float
    mean: Array
    scale: Array
    W: Array
    U: Array
    b: Array
    w: Array
    w0: Array
    origin: Mapping[str, Any] = field(default_factory=dict)
    period: float = 0.0

    @property
    def key(self) -> tuple[str, str]:
        return self.stage, self.target

    @property
    def units(self) -> int:
        return len(self.w)

    def to_json(self) -> dict[str, Any]:
        """Everything but the weights."""
        return {
            "name": NAME, "stage": self.stage, "target": self.target, "bound": self.bound, "interval": self.interval,
            "period": self.period, "origin": dict(self.origin),
        }  # fmt: skip


def input_names(machine: Machine, target: str) -> tuple[str, ...]:
    """Inputs of a network of an axis: the commands of all axes, then its position, speed and load, and a ripple."""
    commands = (axis_signal(name, "command") for name in machine.axis_names)
    driven = machine.axis(target).driven
    return (*commands, driven, f"speed of {target}", f"load of {target}", f"sine over {driven}", f"cosine over {driven}")


def check_residual(machine: Machine, linked: Sequence[str], item: Residual) -> None:
    """Check that a machine can have this network.

    Raises:
        SettingsError: a stage or axis that cannot have one, or parameters of a wrong shape or range.
    """
    where = f"machine {machine.name}: {NAME} on {item.target}"
    if item.stage not in STAGES:
        raise SettingsError(where, f"stage {item.stage!r}", f"one of {', '.join(STAGES)}", "Other stages cannot have one.")
    axis = machine.axis(item.target)
    fits = {
        "command": axis.actuation in ("velocity", "position"),
        "joint": axis.drives == "cylinder" and item.target in linked,
        "force": axis.actuation == "force",
    }
    if not fits[item.stage]:
        expected = {"command": "a velocity or position axis", "joint": "a cylinder with a linkage", "force": "a force axis"}
        raise SettingsError(where, f"stage {item.stage!r} of a {axis.actuation}-actuated {axis.drives}", expected[item.stage])
    F, H = len(input_names(machine, item.target)), item.units
    shapes = {"mean": (F,), "scale": (F,), "W": (4 * H, F), "U": (4 * H, H), "b": (4 * H,), "w": (H,), "w0": (1,)}
    for name, shape in shapes.items():
        values = getattr(item, name)
        if values.shape != shape or not np.isfinite(values).all():
            raise SettingsError(where, f"{name} of shape {values.shape}", f"finite numbers of shape {shape}")
    if not (math.isfinite(item.period) and item.period >= 0.0):
        raise SettingsError(where, f"period = {item.period}", "a length, or zero for none")
    for name in ("bound", "interval"):
        if not (math.isfinite(getattr(item, name)) and getattr(item, name) > 0.0):
            raise SettingsError(where, f"{name} = {getattr(item, name)}", "a positive number")


def residual_arrays(machine: Machine, residuals: Sequence[Residual]) -> ResidualArrays | None:
    """Networks as arrays for the kernels; None without networks."""
    if not residuals:
        return None
    flat = [cell.flat_weights(vars(item)) for item in residuals]
    weights = np.zeros((len(residuals), max(map(len, flat))))
    about = np.zeros((len(residuals), 6))
    for row, (item, values) in enumerate(zip(residuals, flat, strict=True)):
        weights[row, : len(values)] = values
        place = machine.axis_names.index(item.target)
        about[row] = place, STAGES.index(item.stage), item.units, item.interval, item.bound, item.period
    return ResidualArrays(about, np.array([r.mean for r in residuals]), np.array([r.scale for r in residuals]), weights)


def new_memory(nets: ResidualArrays) -> Array:
    """Initial memory of networks, (R, M)."""
    memory = np.zeros((len(nets.about), STATES + cell.state_size(nets.mean.shape[1], int(nets.about[:, UNITS].max()))))
    memory[:, AGE] = np.nan
    return memory


def check_step(residuals: Sequence[Residual], dt: float) -> None:
    """Raise SettingsError where steps are longer than the interval of a network."""
    for item in residuals:
        if dt > 1.001 * item.interval:
            raise SettingsError(
                f"{NAME} on {item.target} ({item.stage} stage)",
                f"steps of {dt:g} s",
                f"at most {item.interval:g} s, the interval that it was learned with",
                "Run the plant at a higher rate, or take the version without it.",
            )


# -- compiled ---------------------------------------------------------------------------------------------------------------


@inlined
def reset_memory(s):
    """Reset the memory of a network (M,) to its initial state."""
    for k in range(len(s)):
        s[k] = 0.0
    s[AGE] = np.nan


@inlined
def reset_axis(nets, t, i):
    """The same for all networks of axis ``i``, memory (R, M)."""
    for r in range(len(t)):
        if nets.about[r, AXIS] == i:
            reset_memory(t[r])


@inlined
def contribution(nets, t, i, stage):
    """Contribution to a stage of axis ``i``, from the memory (R, M)."""
    total = 0.0
    for r in range(len(t)):
        if nets.about[r, AXIS] == i and nets.about[r, STAGE] == stage:
            total += t[r, OUTPUT]
    return total


@loop
def update(nets, r, s, command, x, load, dt):
    """Update the network at the beginning of a step of length ``dt``, if it is due; return its contribution to the step.

    Args:
        s: memory of network ``r`` (M,).
        command: of all axes (A,); ``x`` is the position of its axis. While that is NaN, there is no update.
    """
    interval = nets.about[r, INTERVAL]
    since = s[AGE]
    due = np.isnan(since) or since >= interval - 0.5 * dt
    if not due or np.isnan(x):
        if not np.isnan(since):
            s[AGE] = since + dt
        return s[OUTPUT]
    speed = 0.0 if np.isnan(since) else (x - s[LAST_POSITION]) / since
    s[AGE] = dt
    s[LAST_POSITION] = x
    axes, units = len(command), int(nets.about[r, UNITS])
    inputs = axes + 5
    turn = 2.0 * math.pi * x / nets.about[r, PERIOD] if nets.about[r, PERIOD] > 0.0 else 0.0
    at = STATES + 3 * units
    for j in range(axes):
        s[at + j] = command[j]
    s[at + axes] = x
    s[at + axes + 1] = speed
    s[at + axes + 2] = load
    s[at + axes + 3] = math.sin(turn)
    s[at + axes + 4] = math.cos(turn)
    for j in range(inputs):
        s[at + j] = cell.standardised(s[at + j], nets.mean[r, j], nets.scale[r, j])
    s[OUTPUT] = nets.about[r, BOUND] * math.tanh(cell.lstm_step(nets.weights[r], inputs, units, s, STATES))
    return s[OUTPUT]


@inlined
def update_stage(net, k, x, load, dt):
    """:func:`update` of the network of a :class:`StageResidual` at the beginning of step ``k``."""
    return update(net.nets, net.row, net.memory, net.commands[k], x, load, dt)


# -- files ------------------------------------------------------------------------------------------------------------------


def to_tensors(residuals: Sequence[Residual]) -> bytes:
    """Weights of all networks as safetensors."""
    from safetensors.numpy import save

    return save(
        {f"{r.stage}.{r.target}/{name}": np.ascontiguousarray(getattr(r, name)) for r in residuals for name in cell.TENSORS}
    )


def from_files(entries: Sequence[Mapping[str, Any]], files: Mapping[str, bytes], where: str) -> tuple[Residual, ...]:
    """Networks whose :meth:`Residual.to_json` and :func:`to_tensors` these are.

    Raises:
        StoreError: weights are missing or damaged.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    if not entries:
        return ()
    try:
        tensors = load(files[FILE])
        found = []
        for entry in entries:
            prefix = f"{entry['stage']}.{entry['target']}/"
            arrays: dict[str, Any] = {name: np.asarray(tensors[prefix + name], dtype=np.float64) for name in cell.TENSORS}
            about: dict[str, Any] = {key: entry[key] for key in ("stage", "target", "bound", "interval", "period")}
            found.append(Residual(**about, **arrays, origin=json.loads(json.dumps(entry["origin"]))))
        return tuple(found)
    except (KeyError, TypeError, ValueError, SafetensorError) as error:
        raise StoreError(where, f"no weights of {NAME} ({type(error).__name__}: {error})", f"{FILE} as it was stored") from None
