"""Settings of the hydraulic drive model, from the spool of a valve to the motion of the booms.

An axis with ``drive = "hydraulic"`` keeps ``gain``, ``delay``, ``deadband_*`` (as overlap of the lands) and ``saturation`` of
its valve; spool, flow, pressures and friction are set here. The default of every feature is its absence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sysid.config import Strict


@dataclass(frozen=True)
class HydraulicSettings(Strict):
    """Valve and cylinder (or rotary drive) of one axis.

    Units are those of a cylinder; a drive that turns has m³/rad for areas, N·m for forces and rad for lengths.

    Args:
        area, area_rod: piston areas that push towards positive and negative motion [m²].
        dead_volume: hose and port volume on either side [m³].
        spool_frequency, spool_damping: own frequency [Hz] and damping ratio of the spool.
        flow_force: displacement of the open spool by a pressure drop equal to the supply pressure (share of its opening).
        hysteresis: full width of the widest play operator of the spool's friction [command].
        meter_out_lap: additional overlap of the edges to the tank over those from the pump [command].
        retraction: speed at opening −1 without load; None = the same opening as in the positive direction.
        leakage: across the piston [m³/(s·Pa)]; ``spool_leakage``: from either chamber past the spool to the tank.
        coulomb, static: seal friction when sliding and at break-away [N]; static 0 = as sliding.
        stribeck_velocity: speed over which it falls from one to the other [m/s]; viscous: [N·s/m] at reference temperature.
        bristle: elastic deflection of the seals before they slide [m].
        relief: pressure at which a chamber opens to the tank [Pa].
    """

    area: float
    area_rod: float
    dead_volume: float = 2e-5
    spool_frequency: float = 6.0
    spool_damping: float = 0.9
    flow_force: float = 0.0
    hysteresis: float = 0.0
    meter_out_lap: float = 0.0
    retraction: float | None = None
    leakage: float = 0.0
    spool_leakage: float = 0.0
    coulomb: float = 0.0
    static: float = 0.0
    stribeck_velocity: float = 5e-3
    viscous: float = 0.0
    bristle: float = 2e-5
    relief: float = math.inf


@dataclass(frozen=True)
class SupplySettings(Strict):
    """The pump of all axes: it holds ``pressure`` [Pa] as long as less than ``flow_limit`` [m³/s] is drawn.

    ``volume`` [m³] is that of the pressure line, ``droop`` [Pa] the pressure lost between no flow and the full flow.
    ``parked`` [Pa] is the pressure in the unloaded chamber of a drive that has been at rest for a long time.
    ``rated`` [Pa] is the pressure for which the valves' gains are stated; None = ``pressure``.
    """

    pressure: float = 80e5
    rated: float | None = None
    parked: float = 2e5
    flow_limit: float = math.inf
    volume: float = 1e-4
    droop: float = 2e5


@dataclass(frozen=True)
class OilSettings(Strict):
    """The oil and its temperature ``end + (start − end)·e^(−t/warm_up)`` [°C, s].

    Args:
        bulk_modulus: effective, with hoses and air [Pa].
        transition: pressure drop around which an orifice goes from laminar to turbulent at ``reference`` [Pa].
        thinning: relative loss of viscosity per kelvin [1/K].
    """

    bulk_modulus: float = 5e8
    transition: float = 2e4
    reference: float = 40.0
    start: float = 40.0
    end: float = 40.0
    warm_up: float = 600.0
    thinning: float = 0.035


@dataclass(frozen=True)
class MassSettings(Strict):
    """Masses [kg], their centres along the link [m] and moments of inertia about them [kg·m²].

    The telescope's centre is counted from the boom tip (negative = behind it). The gripper hangs below the tip.
    ``balanced`` is the share of all weights that springs or counterweights compensate.
    """

    column_inertia: float = 0.011
    boom: float = 4.0
    boom_centre: float = 0.288
    boom_inertia: float = 0.112
    stick: float = 3.0
    stick_centre: float = 0.2
    stick_inertia: float = 0.041
    telescope: float = 1.5
    telescope_centre: float = -0.18
    telescope_inertia: float = 0.0165
    gripper: float = 3.0
    payload: float = 0.0
    balanced: float = 0.0
