"""Cards of identified actuators: a plant of the actuator alone, its evidence, and its export to simulators."""

from sysid.actuators.card import ActuatorCard, card_named, card_names, is_card

__all__ = ["ActuatorCard", "card_named", "card_names", "is_card"]
