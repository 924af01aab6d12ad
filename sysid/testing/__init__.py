"""Checks of effects, of the catalogue and of users: ``check_effect(effect)`` raises if a property does not hold."""

from sysid.testing.check import PROPERTIES, EffectError, Failure, check_effect, failures_of
from sysid.testing.probe import EffectPlace, Run, places_of, plant_run, probe_machine, probe_recording

__all__ = [
    "PROPERTIES",
    "EffectError",
    "EffectPlace",
    "Failure",
    "Run",
    "check_effect",
    "failures_of",
    "places_of",
    "plant_run",
    "probe_machine",
    "probe_recording",
]
