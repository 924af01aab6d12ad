"""Checks for effects, for the catalogue and for a user's own: ``check_effect(effect)`` raises where a promise is broken."""

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
