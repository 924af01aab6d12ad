"""The machines of the cases as their owners describe them: four families with variants."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from agreement.machines import PISTONS
from simulated_bench.case import overlaid
from simulated_bench.recipe import AXES
from sysid.config import read_toml

Family = Literal["valve_crane", "hydraulic_crane", "servo_arm", "slide"]
Tables = dict[str, Any]
BENCH = Path(__file__).resolve().parents[2] / "datasets" / "autolog" / "bench.toml"
#: Number of variants of each family; the nominal plant of a variant is fitted once.
VARIANTS = 6
#: Standard deviations at noise 1: draw wire [m], marker coordinate [m], servo joint [rad], slide position [m] and force [N].
WIRE, MARKER, SERVO, PLACE, FORCE = 2e-5, 1.5e-4, 1e-4, 1e-6, 0.5
#: Oil of the hydraulic cranes, warm or just started [°C]; only cold oil can warm up enough to be felt.
WARM, COLD = 40.0, 0.0
COLD_VARIANTS = (0, 2)
#: Programs of the recordings, the last one held out, and their length [s].
EXCITATION: Mapping[str, tuple[tuple[str, ...], float]] = {
    "rich": (("operator", "steps", "stairs", "together", "operator", "operator"), 46.0),
    "rest": (("rest", "operator", "rest", "operator", "rest", "rest"), 46.0),
    "together": (("operator", "together", "steps", "operator", "together", "operator"), 46.0),
    "poor": (("operator", "operator", "operator"), 30.0),
    "flight": (("flight",) * 6, 46.0),
    "long": (("operator",) * 4, 120.0),
    "ten minutes": (("operator", "steps", "stairs", "together", "operator", "operator"), 100.0),
}


@cache
def visible_tables(family: str, variant: int) -> Tables:
    """The machine that the owner describes, as tables of its recipe, without recordings and noise."""
    draw = np.random.default_rng([family_number(family), variant])
    if family == "servo_arm":
        axes = []
        for name, limits, length, mass in (("shoulder", (-0.5, 1.5), 0.3, 1.0), ("elbow", (-2.0, 0.5), 0.25, 0.6)):
            known = {"delay": round(draw.uniform(0.01, 0.03), 4), "time_constant": round(draw.uniform(0.02, 0.05), 4)}
            axes.append({"name": name, "limits": list(limits), "length": length, "mass": mass, **known})
        return {"kind": "servo_arm", "name": "arm", "seed": 1, "axes": axes, "recordings": []}
    if family == "slide":
        known = {"mass": round(draw.uniform(60.0, 120.0), 1), "viscous": round(draw.uniform(100.0, 250.0), 1)}
        if variant % 2:
            known["coulomb"] = round(draw.uniform(10.0, 20.0), 1)
        return {"kind": "slide", "name": "slide", "seed": 1, "recordings": [], **known}
    return _crane(family, variant, draw)


def _crane(family: str, variant: int, draw: np.random.Generator) -> Tables:
    shipped = read_toml(BENCH)
    shipped.pop("hidden")
    axes: Tables = {}
    for name in AXES:
        valve = shipped["axes"][name]["valve"]
        axes[name] = {
            "backlash": 0.0,
            "valve": {
                "gain": round(valve["gain"] * draw.uniform(0.8, 1.2), 5),
                "delay": round(draw.uniform(0.015, 0.045), 4),
                "time_constant": round(draw.uniform(0.03, 0.07), 4),
                "deadband_positive": round(draw.uniform(0.06, 0.2), 3),
                "deadband_negative": round(draw.uniform(0.06, 0.2), 3),
            },
        }
    tables = overlaid(
        shipped,
        {
            "name": "crane",
            "axes": axes,
            "slew_sensor": {"error": 0.0},
            # Half of the cranes have a known hook, half hold the tool rigidly.
            "gripper": {"length": 0.22, "damping_ratio": 0.04} if variant % 2 else {"length": 0.0, "damping_ratio": 0.0},
            "capture": {"swaps": [], "exported_markers": []},
            "recordings": [],
        },
    )
    if family == "valve_crane":
        return tables
    for name in hydraulic_axes(variant):
        drive: Tables = {"drive": "hydraulic", "hydraulics": dict(PISTONS[name])}
        if "retraction" in PISTONS[name]:
            drive["hydraulics"]["retraction"] = tables["axes"][name]["valve"]["gain"]
        # The second-order spool of the circuit replaces the lag.
        tables = overlaid(tables, {"axes": {name: {**drive, "valve": {"time_constant": 0.0}}}})
    degrees = COLD if variant in COLD_VARIANTS else WARM
    oil = {"start": degrees, "end": degrees, "warm_up": 60.0, "transition": 5e4}
    return overlaid(tables, {"masses": {"balanced": 1.0}, "oil": oil, "supply": {"rated": 80e5, "flow_limit": 1.2e-4}})


def family_number(family: str) -> int:
    return ("valve_crane", "hydraulic_crane", "servo_arm", "slide").index(family)


def hydraulic_axes(variant: int) -> tuple[str, ...]:
    """Axes of a hydraulic crane that have a circuit: one of the first three, or all."""
    return (AXES[variant % 3],) if variant < 3 else AXES


def recorded(tables: Tables, excitation: str, noise: float, disturbance: float, seed: int) -> Tables:
    """The tables with recordings, ``noise`` as a multiple of the usual, and the relative flow disturbance of the valves."""
    programs, seconds = EXCITATION[excitation]
    kind = tables.get("kind")
    if kind is not None:
        length = {"servo_arm": 40.0, "slide": 15.0}[kind] * (0.5 if excitation == "poor" else 1.0)
        count = 3 if excitation == "poor" else 6
        takes = [{"name": f"take-{k + 1}", "seed": seed + k, "seconds": length} for k in range(count)]
        sensors = {"noise": SERVO * noise} if kind == "servo_arm" else {"noise": PLACE * noise, "force_noise": FORCE * noise}
        return {**tables, "seed": seed, "recordings": takes, **sensors}
    takes = [
        {"name": f"take-{k + 1}", "seed": seed + k, "seconds": seconds, "program": program}
        for k, program in enumerate(programs)
    ]
    seen = {"draw_wire": {"noise": WIRE * noise}, "capture": {"noise": MARKER * noise}}
    calm = {name: {"valve": {"disturbance": disturbance}} for name in AXES}
    return overlaid(tables, {"seed": seed, "recordings": takes, "axes": calm, **seen})
