"""Block of a card: what a version changes against the one before, in its predictions or its effects."""

from __future__ import annotations

from sysid.display import quantity
from sysid.effects import BY_NAME
from sysid.effects.wording import title_of
from sysid.registry.effect_changes import EffectChange, effect_interval, effect_value
from sysid.versions.card_block import CardBlock
from sysid.versions.diff import ModelDiff, PredictionChange


def changes(found: ModelDiff) -> CardBlock | None:
    """Predictions of networks, effects of plants; None for other kinds."""
    title = f"Changed since {found.before}"
    if found.predictions:
        about = "Difference of the predictions over the range that both versions were fitted on."
        header: tuple[str, ...] = ("output", "largest difference", "RMS", "largest at")
        return CardBlock(title, (about,), header, tuple(map(_prediction, found.predictions)))
    if found.kind == "plant":
        header = ("effect", "on", "parameter", "before", "after", "95 % interval")
        same = () if found.effects else ("The effects are the same.",)
        return CardBlock(title, same, header, tuple(map(_effect, found.effects)))
    return None


def _prediction(entry: PredictionChange) -> tuple[str, ...]:
    at = ", ".join(f"{signal} {value:.4g}" for signal, value in entry.at.items())
    where = at if entry.points else "the fitted ranges do not overlap"
    return entry.output, quantity(entry.largest, entry.unit), quantity(entry.rms, entry.unit), where


def _effect(change: EffectChange) -> tuple[str, ...]:
    title = title_of(BY_NAME[change.effect], change.target, None) if change.effect in BY_NAME else change.effect
    before, after = (effect_value(value, change.unit) for value in (change.before, change.after))
    ends = effect_interval(change.interval95, change.unit)
    return title, change.target, change.parameter.replace("_", " "), before, after, ends
