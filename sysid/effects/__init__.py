"""Named effects: departures of a machine from its nominal simulation, one file each."""

from sysid.effects.catalogue import BY_NAME, CATALOGUE, effect_named, form_for
from sysid.effects.effect import Effect, Form, Need, Parameter, Slot

__all__ = ["BY_NAME", "CATALOGUE", "Effect", "Form", "Need", "Parameter", "Slot", "effect_named", "form_for"]
