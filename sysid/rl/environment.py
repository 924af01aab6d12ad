"""What a policy learns in: n copies of a machine side by side, joint setpoints in, observations and rewards out.

Source: the paper's DDPG components. An observation begins with the joints, the end effector and its target; the reward of a
step is ``0.001 + (0.002 − ‖target − ee‖) − 0.0005·[a setpoint outside its limits]`` [m].
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from sysid.networks.forward import ForwardModel
from sysid.rl.task import Flags

Array = npt.NDArray[np.float64]


class Environment(Protocol):
    """``size`` copies that know nothing of each other; all arrays are fresh, so they may be kept.

    ``spread``: how far from where a copy stands its next target lies, as a share of the way to anywhere within reach.
    """

    spread: float

    @property
    def size(self) -> int: ...

    @property
    def observations(self) -> int: ...

    @property
    def actions(self) -> int: ...

    @property
    def action_low(self) -> Array: ...

    @property
    def action_high(self) -> Array: ...

    @property
    def observation_low(self) -> Array: ...

    @property
    def observation_high(self) -> Array: ...

    @property
    def steps(self) -> int: ...

    @property
    def forward(self) -> ForwardModel: ...

    @property
    def final(self) -> Array: ...

    @property
    def rate_hz(self) -> float: ...

    @property
    def names(self) -> tuple[str, ...]: ...

    def seed(self, seed: int) -> None: ...

    def reset(self) -> Array: ...

    def step(self, actions: Array) -> tuple[Array, Array, Flags]: ...

    def targets(self, observations: Array) -> Array: ...

    def predicted(self, observations: Array, actions: Array) -> Array: ...

    def begin(self, joints: npt.ArrayLike, targets: npt.ArrayLike) -> Array: ...

    def aim(self, targets: npt.ArrayLike) -> Array: ...

    def state(self) -> dict[str, Any]: ...

    def restore(self, state: Mapping[str, Any]) -> None: ...
