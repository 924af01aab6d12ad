"""Properties that every effect must have, checked on the compiled plant by :func:`check_effect`."""

from __future__ import annotations

import itertools
import string
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.effects import BY_NAME, Effect, Form, Parameter, input_delay
from sysid.effects.catalogue import confusions
from sysid.errors import SysidError, nearest
from sysid.testing.probe import RATE_HZ, EffectPlace, Run, Values, places_of, plant_run, probe_recording, with_inputs

Array = npt.NDArray[np.float64]

#: Relative tolerance for results that are equal up to rounding.
ROUNDING = 1e-9
#: Units of parameters; ``drive``, ``joint`` and ``signal`` are m or rad by the target; of two, a prismatic axis has the first.
UNITS = frozenset(
    {
        *("1", "s", "1/s", "Hz", "ppm", "m", "rad", "drive", "joint", "drive/s", "command/s", "signal"),
        *("N or N·m", "N·s/m or N·m·s/rad", "m/N or rad/(N·m)", "1/N or 1/(N·m)", "kg", "kg·m", "kg·m²"),
    }
)


class EffectError(SysidError):
    """An effect lacks a property."""


@dataclass(frozen=True)
class Failure:
    """A property that does not hold: its name, the place, the figures."""

    check: str
    place: str
    figures: str

    def __str__(self) -> str:
        return f"{self.check} at {self.place}: {self.figures}" if self.place else f"{self.check}: {self.figures}"


def check_effect(effect: Effect, run: Run | None = None) -> None:
    """Check metadata and behaviour of an effect.

    Args:
        effect: its description.
        run: simulation of its stage, for an effect that the compiled plant does not have yet: (parameters or None, recording) →
            output (n, d), on the recordings of :func:`sysid.testing.probe_recording`. Default: the compiled plant.

    Raises:
        EffectError: lists every property that does not hold, with figures.
    """
    found = failures_of(effect, run)
    if found:
        raise EffectError(f"effect {effect.name}", "; ".join(map(str, found)), f"all of: {', '.join(PROPERTIES)}")


def failures_of(effect: Effect, run: Run | None = None) -> tuple[Failure, ...]:
    """Every property that does not hold. Behaviour is checked only if the metadata are complete."""
    found = [Failure("metadata", "", text) for text in _metadata(effect)]
    if found:
        return tuple(found)
    for place in places_of(effect):
        subject = _Subject(effect, place, run or plant_run(effect, place))
        for name, check in PROPERTIES.items():
            figures = None if name in effect.exempt else next(check(subject), None)
            if figures is not None:
                found.append(Failure(name, str(place), figures))
    return tuple(found)


@dataclass(frozen=True)
class _Subject:
    """One effect at one place."""

    effect: Effect
    place: EffectPlace
    run: Run

    def inputs(self, recording: Recording) -> Array:
        return np.column_stack([recording.values(name) for name in self.place.inputs])

    def driven(self, values: Values | None, inputs: Array) -> Array:
        return self.run(values, with_inputs(_RICH, self.place.inputs, inputs))


_RICH = probe_recording()


def neutral_values(effect: Effect, form: Form) -> dict[str, float | list[float]]:
    """The neutral values of a form, clipped to its bounds."""
    neutral = {slot.name: slot.neutral for slot in effect.slots}
    return _values(form, lambda p, group: float(np.clip(neutral[group[0]], *p.bounds)))


def typical_values(effect: Effect, form: Form) -> dict[str, float | list[float]]:
    """Values with a visible effect: the first start that is not neutral, else a multiple of the ROPE half-width."""
    neutral = {slot.name: slot.neutral for slot in effect.slots}

    def value(parameter: Parameter, group: tuple[str, ...]) -> float:
        base = neutral[group[0]]
        away = [start for start in parameter.starts if start != base]
        return away[0] if away else base + (30.0 * parameter.negligible or 1.0)

    return _values(form, value)


def _values(form: Form, value: Callable[[Parameter, tuple[str, ...]], float]) -> dict[str, float | list[float]]:
    found: dict[str, float | list[float]] = {}
    for parameter in form.parameters:
        part = [value(parameter, group) for group in parameter.components]
        found[parameter.name] = part[0] if len(part) == 1 else part
    return found


# -- properties: each function yields the figures of violations ----------------------------------------------------


def _metadata(effect: Effect) -> Iterator[str]:
    for key in ("name", "title", "equation", "source", "excited_by"):
        if not str(getattr(effect, key)).strip():
            yield f"{key} is empty"
    if not effect.slots or not effect.forms:
        yield f"{len(effect.slots)} slots and {len(effect.forms)} forms, at least one of each expected"
    if effect.target == "axis" and not effect.actuations:
        yield "an axis effect names no kind of actuation"
    for form in effect.forms:
        if not any(_fields(sentence) <= {"target", *form.names} for sentence in effect.sentences):
            yield f"no sentence has the parameters {{{', '.join(form.names)}}} alone"
    if not confusions(effect):
        yield "confused_with is empty: every effect can be confused with another one"
    for other in effect.confused_with:
        if other not in BY_NAME or other == effect.name:
            yield f"confused_with names {other!r}, expected {nearest(other, BY_NAME.keys() - {effect.name})}"
    slots = {slot.name for slot in effect.slots}
    if unwritten := slots - {slot for form in effect.forms for slot in form.slots}:
        yield f"no form writes the slots {sorted(unwritten)}"
    for form in effect.forms:
        written = form.slots
        if not set(written) <= slots or len(set(written)) != len(written):
            yield f"form {{{', '.join(form.names)}}} writes the slots {sorted(written)}, expected some of {sorted(slots)} once"
        for parameter in form.parameters:
            yield from _parameter(parameter)


def _fields(template: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(template) if name}


def _parameter(parameter: Parameter) -> Iterator[str]:
    low, high = parameter.bounds
    if parameter.unit not in UNITS:
        yield f"{parameter.name}: unit {parameter.unit!r} is not one of {sorted(UNITS)}"
    if not parameter.about.strip():
        yield f"{parameter.name}: about is empty"
    if not (np.isfinite([low, high]).all() and low < high):
        yield f"{parameter.name}: bounds [{low}, {high}]"
    if not parameter.starts:
        yield f"{parameter.name}: no value to start a fit from"
    outside = [start for start in parameter.starts if not low <= start <= high]
    if outside:
        yield f"{parameter.name}: starts {outside} lie outside of the bounds [{low}, {high}]"
    if parameter.negligible < 0.0:
        yield f"{parameter.name}: negligible = {parameter.negligible}"


def _neutral(subject: _Subject) -> Iterator[str]:
    without = subject.run(None, _RICH)
    for form in subject.effect.forms:
        values = neutral_values(subject.effect, form)
        yield from _differ(f"with {_text(values)} and without it", subject.run(values, _RICH), without, 0.0)


def _acts(subject: _Subject) -> Iterator[str]:
    without = subject.run(None, _RICH)
    for form in subject.effect.forms:
        values = typical_values(subject.effect, form)
        if np.array_equal(subject.run(values, _RICH), without, equal_nan=True):
            yield f"{_text(values)} changes nothing"


def _causal(subject: _Subject) -> Iterator[str]:
    at = 2 * len(_RICH) // 3
    changed = subject.inputs(_RICH).copy()
    changed[at:] += 0.05 * np.ptp(changed, axis=0)
    for form in subject.effect.forms:
        values = typical_values(subject.effect, form)
        one, other = subject.run(values, _RICH), subject.driven(values, changed)
        yield from _differ(f"before the input changes at sample {at}", other[:at], one[:at], 0.0)


def _deterministic(subject: _Subject) -> Iterator[str]:
    for form in subject.effect.forms:
        values = typical_values(subject.effect, form)
        yield from _differ("in a second run of the same", subject.run(values, _RICH), subject.run(values, _RICH), 0.0)


def _reset(subject: _Subject) -> Iterator[str]:
    other = subject.inputs(_RICH)[::-1] * 0.7
    for form in subject.effect.forms:
        values = typical_values(subject.effect, form)
        first = subject.run(values, _RICH)
        subject.driven(values, other)
        yield from _differ("after a run of something else", subject.run(values, _RICH), first, 0.0)


def _finite(subject: _Subject) -> Iterator[str]:
    effect = subject.effect
    for form in effect.forms:
        tried = [_values(form, lambda p, _, end=end: p.bounds[end]) for end in (0, 1)]  # type: ignore[misc]
        if len(form.parameters) == 2:
            tried += [
                _values(form, lambda p, _, first=form.parameters[0], end=end: p.bounds[end if p is first else 1 - end])  # type: ignore[misc]
                for end in (0, 1)
            ]
        tried += [typical_values(effect, form)]
        for values, (kind, inputs) in itertools.product(tried, _hostile(subject.inputs(_RICH))):
            out = subject.driven(values, inputs)
            there = ~np.isnan(inputs).any(axis=1)
            wrong = np.flatnonzero(there & ~np.isfinite(out).all(axis=1))
            if len(wrong):
                yield f"{_text(values)}, {kind}: {len(wrong)} samples are not finite, the first at {wrong[0]}"


def _hostile(inputs: Array) -> Iterator[tuple[str, Array]]:
    count = len(inputs)
    centre, reach = inputs[0], np.ptp(inputs, axis=0)
    square = np.where((np.arange(count) // 7) % 2 == 0, 1.0, -1.0)[:, None]
    yield "full steps every 0.07 s", centre + 0.5 * reach * square
    yield "nothing moves", np.repeat(centre[None], count, axis=0)
    rng = np.random.default_rng(0)
    yield "white noise", centre + reach * rng.uniform(-0.5, 0.5, inputs.shape)
    gaps = inputs.copy()
    gaps[count // 3 : count // 3 + 5] = np.nan
    gaps[count // 2 : count // 2 + 60] = np.nan
    yield "gaps of 0.05 s and 0.6 s", gaps


def _time_invariant(subject: _Subject) -> Iterator[str]:
    """Rest before the start only delays the output. Force axes are left out: a load moves them at rest."""
    if subject.effect.stage == "force":
        return
    inputs = subject.inputs(_RICH)
    later = 37
    waiting = np.vstack([np.repeat(inputs[:1], later, axis=0), inputs])
    for form in subject.effect.forms:
        values = typical_values(subject.effect, form)
        one, other = np.diff(subject.run(values, _RICH), axis=0), np.diff(subject.driven(values, waiting), axis=0)
        yield from _differ(f"in its increments after {later} samples of rest", other[later:], one, ROUNDING)


def _memoryless(subject: _Subject) -> Iterator[str]:
    """Without memory, permuted inputs give outputs (of a drive: increments) in the same permutation."""
    effect = subject.effect
    if effect.memory(1.0 / RATE_HZ) > 0 or effect.stage == "force":
        return
    inputs = subject.inputs(_RICH)
    order = np.random.default_rng(1).permutation(len(inputs))
    for form in effect.forms:
        values = typical_values(effect, form)
        one, other = subject.run(values, _RICH), subject.driven(values, inputs[order])
        if effect.stage == "command":
            kept = order[:-1] < len(inputs) - 1
            one, other = np.diff(one, axis=0)[order[:-1][kept]], np.diff(other, axis=0)[kept]
        else:
            one = one[order]
        yield from _differ("after its inputs were put into another order", other, one, ROUNDING)


def _rate_independent(subject: _Subject) -> Iterator[str]:
    """The same path at a third of the speed gives the same outputs along it."""
    if not subject.effect.rate_independent or (subject.place.stage == "drive" and subject.effect.stage == "joint"):
        return
    slow = np.repeat(subject.inputs(_RICH), 3, axis=0)
    for form in subject.effect.forms:
        values = typical_values(subject.effect, form)
        one, other = subject.run(values, _RICH), subject.driven(values, slow)
        if subject.place.stage == "drive":
            one, other = np.diff(one, axis=0), np.diff(other, axis=0)
        one = np.repeat(one, 3, axis=0)[: len(other)]
        other = other[: len(one)]
        yield from _differ("on the same path at a third of the pace", other, one, ROUNDING)


def _shifts(subject: _Subject) -> Iterator[str]:
    """A delay of whole samples is a shift in time."""
    if subject.effect.name != input_delay.EFFECT.name:
        return
    without = subject.run(None, _RICH)
    for samples in (1, 13):
        late = subject.run({"delay": samples / RATE_HZ}, _RICH)
        yield from _differ(f"from a shift by {samples} samples", late[samples:], without[: len(without) - samples], ROUNDING)


def _differ(what: str, one: Array, other: Array, rounding: float) -> Iterator[str]:
    """Figures if two results differ by more than ``rounding``."""
    if one.shape != other.shape:
        yield f"{what}: shapes {one.shape} and {other.shape}"
        return
    size = float(np.nanmax(np.abs(other), initial=0.0)) or 1.0
    unlike = np.isnan(one) != np.isnan(other)
    distance = np.where(unlike, np.inf, np.nan_to_num(np.abs(one - other)))
    if distance.size and distance.max() > rounding * size:
        at = int(np.argmax(distance.max(axis=1)))
        yield f"differs {what} by {distance.max():.3g} at sample {at} (largest value {size:.3g})"


def _text(values: Values) -> str:
    return ", ".join(f"{key} = {value}" for key, value in values.items())


#: The properties, in the order of their checks.
PROPERTIES: dict[str, Callable[[_Subject], Iterator[str]]] = {
    "neutral": _neutral,
    "acts": _acts,
    "causal": _causal,
    "deterministic": _deterministic,
    "reset": _reset,
    "finite": _finite,
    "time_invariant": _time_invariant,
    "memoryless": _memoryless,
    "rate_independent": _rate_independent,
    "shift": _shifts,
}
