"""Irregularities of a drive that no effect of the catalogue describes, so that none must be named for them.

All of them change the share of the valve's flow that becomes motion: an unevenly worn barrel or sprocket, a pulsating pump, a
clutch that slips at high flow, and a valve whose coil loses force while it is held open.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import NamedTuple

from simulated_bench.compiled import compiled
from sysid.config import Strict


@dataclass(frozen=True)
class IrregularSettings(Strict):
    """Every share is 0 by default: a regular drive.

    Args:
        uneven, pitch: the speed varies by ± this share with the position, once every ``pitch`` of the drive [1, m or rad].
        ripple, ripple_frequency: it varies by ± this share with time [1, Hz].
        slip, slip_above: this share of the speed is lost while the opening is beyond ``slip_above`` [1, command].
        fade, fade_time: share lost by a valve held fully open, and the time constant of loss and recovery [1, s].
    """

    uneven: float = 0.0
    pitch: float = 1.0
    ripple: float = 0.0
    ripple_frequency: float = 1.0
    slip: float = 0.0
    slip_above: float = 1.0
    fade: float = 0.0
    fade_time: float = 10.0


class Irregular(NamedTuple):
    """The settings as numbers the compiled loop can take."""

    uneven: float
    pitch: float
    ripple: float
    ripple_frequency: float
    slip: float
    slip_above: float
    fade: float
    fade_time: float


def irregular_of(settings: IrregularSettings) -> Irregular:
    return Irregular(**asdict(settings))


@compiled
def flow_share(opening: float, position: float, time: float, held: float, drive: Irregular, step: float) -> tuple[float, float]:
    """Share of the flow that becomes motion at a valve ``opening`` [command], and how long it was ``held`` open."""
    share = 1.0
    if drive.uneven != 0.0:
        share *= 1.0 + drive.uneven * math.sin(2.0 * math.pi * position / drive.pitch)
    if drive.ripple != 0.0:
        share *= 1.0 + drive.ripple * math.sin(2.0 * math.pi * drive.ripple_frequency * time)
    if drive.slip != 0.0 and abs(opening) > drive.slip_above:
        share *= 1.0 - drive.slip
    if drive.fade != 0.0:
        share *= 1.0 - drive.fade * held
        held += (min(abs(opening), 1.0) - held) * (1.0 - math.exp(-step / drive.fade_time))
    return share, held
