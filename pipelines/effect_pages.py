"""``docs/effects`` from the code: one page and one picture an effect. ``python pipelines/effect_pages.py docs/effects``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.effects import CATALOGUE, Effect, Form
from sysid.effects.catalogue import confusions
from sysid.pictures import DARK, PictureCurve, svg, themed
from sysid.signals import point_signals
from sysid.testing.check import typical_values
from sysid.testing.probe import RATE_HZ, EffectPlace, Values, places_of, plant_run, probe_machine, probe_recording, with_inputs

Array = npt.NDArray[np.float64]
GREY, BLUE, ORANGE = "#9aa1a8", "#1f6fb4", "#d9822b"

_STAGES = {
    "command": "command → speed of the drive",
    "force": "force → motion",
    "links": "motion of all joints → forces of an arm",
    "joint": "cylinder (or drive) → joint",
    "end_effector": "joints → end effector",
    "tool": "end effector → hanging tool",
    "sensor": "true signal → measured signal",
}
_NOTICE = "<!-- Written by python pipelines/effect_pages.py docs/effects: change the code instead. -->\n"


def documents() -> dict[str, str]:
    """File name → text, for the whole catalogue."""
    files = {"README.md": _index(), "gallery.md": _gallery()}
    for effect in CATALOGUE:
        files[f"{effect.name}.md"] = page(effect)
        files[f"{effect.name}.svg"] = themed(_picture(effect), DARK | {BLUE: "#58a6ff"})
    return files


def write_documents(folder: Path) -> None:
    """Write :func:`documents` into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in documents().items():
        (folder / name).write_text(text, "utf-8")


def _index() -> str:
    rows = [f"| [`{e.name}`]({e.name}.md) | {_target(e)} | {_parameters(e)} | {e.excited_by} |" for e in CATALOGUE]
    return "\n".join(
        [
            _NOTICE,
            "# Effects\n",
            "This page lists the named effects by which a machine can differ from its nominal plant, in the order in which",
            "the plant applies them. `sysid.testing.check_effect` verifies every effect: absent at its neutral value, causal,",
            'repeatable, finite for any input, without memory of earlier runs. A source "machine facts" refers to',
            "[magnitudes of real effects](../machine-facts.md). The page of an effect has its equation, the",
            "[gallery](gallery.md) its picture.\n",
            "| effect | target | parameters | shows in |",
            "| --- | --- | --- | --- |",
            *rows,
            "",
        ]
    )


def _gallery() -> str:
    """The picture, title and sentence of every effect, by stage. The class ``grid cards`` is of the documentation site."""
    lines = [
        _NOTICE,
        "# Gallery of effects\n",
        "This page shows what each named effect changes: a signal of a machine without the effect (grey) and with it (blue),",
        "or the change of the signal where both would coincide.",
        "Each picture links to the page with equation, parameters and similar effects; all are in [one table](README.md).",
    ]
    for stage, title in _STAGES.items():
        own = [effect for effect in CATALOGUE if effect.stage == stage]
        if own:
            heading = f"\n## {title[:1].upper()}{title[1:]}\n"
            lines += [heading, '<div class="grid cards" markdown>\n', *map(_card, own), "</div>"]
    return "\n".join([*lines, ""])


def _card(effect: Effect) -> str:
    page = f"{effect.name}.md"
    picture = f"[![{effect.title}, with and without]({effect.name}.svg)]({page})"
    return f"- {picture}\n\n    **[{effect.title}]({page})** (`{effect.name}`). {_about(effect)}\n"


def page(effect: Effect) -> str:
    neutral = {slot.name: slot.neutral for slot in effect.slots}
    rows = []
    for form in effect.forms:
        for p in form.parameters:
            size = f" [{len(p.components)}]" if len(p.components) > 1 else ""
            low, high = p.bounds
            rows.append(
                f"| `{p.name}`{size} | {_unit(p.unit)} | {low:g} … {high:g} | {neutral[p.components[0][0]]:g} | {p.about} |"
            )
    about = _about(effect)
    lines = [
        _NOTICE,
        f"# `{effect.name}`: {effect.title}\n",
        f"{about}\n",
        f"![with and without the effect]({effect.name}.svg)\n",
        f"```formula\n{effect.equation}\n```\n",
        f"- **Stage**: {_STAGES[effect.stage]}",
        f"- **Target**: {_target(effect)}",
    ]
    if effect.sides:
        lines.append(f"- **Side**: {' or '.join(f'`{side}`' for side in effect.sides)}, the first where none is given")
    lines += [
        f"- **Shows in**: {effect.excited_by}",
        f"- **Source**: {effect.source}\n",
        "| parameter | unit | bounds | absent at | meaning |",
        "| --- | --- | --- | --- | --- |",
        *rows,
        "",
    ]
    if len(effect.forms) > 1:
        forms = " or ".join("{" + ", ".join(f"`{name}`" for name in form.names) + "}" for form in effect.forms)
        lines.append(f"Written as {forms}, the simplest first.\n")
    lines += ["## Similar effects\n", "| effect | what separates them |", "| --- | --- |"]
    lines += [f"| {_link(other)} | {what} |" for other, what in confusions(effect).items()]
    return "\n".join([*lines, ""])


def _about(effect: Effect) -> str:
    """The first line of the module that defines the effect, without its name."""
    module = sys.modules[f"sysid.effects.{effect.name}"]
    text = (module.__doc__ or "").strip().split("\n")[0].partition(": ")[2]
    return text[:1].upper() + text[1:]


def _parameters(effect: Effect) -> str:
    """Names and units of the parameters, and numbers of components; none for a ratio."""
    found: dict[str, str] = {}
    for parameter in (p for form in effect.forms for p in form.parameters):
        size = f" × {len(parameter.components)}" if len(parameter.components) > 1 else ""
        unit = "" if parameter.unit == "1" else f" [{_unit(parameter.unit)}]"
        found.setdefault(parameter.name, f"`{parameter.name}`{unit}{size}")
    return ", ".join(found.values())


def _target(effect: Effect) -> str:
    if effect.target in ("signal", "stream"):
        return {"signal": "a signal, e.g. `boom.joint`", "stream": "a stream (the stem of its file)"}[effect.target]
    if effect.target != "axis":
        return f"`{effect.target}`"
    return f"an axis ({', '.join(effect.actuations)})"


def _unit(unit: str) -> str:
    words = {"drive/s": "m/s or rad/s", "drive": "m or rad", "joint": "m or rad", "signal": "m or rad"}
    for word, shown in words.items():
        unit = unit.replace(word, shown)
    return unit


def _link(name: str) -> str:
    return f"[`{name}`]({name}.md)"


# -- pictures -------------------------------------------------------------------------------------------------------


def _picture(effect: Effect) -> str:
    place = places_of(effect)[0]
    form = effect.forms[0]
    values = dict(effect.example) or typical_values(effect, form)
    title = f"{effect.name} with {', '.join(f'{key} = {value}' for key, value in values.items())}"
    if effect.of_links:
        return _links_picture(effect, place, values, title)
    if effect.stage == "end_effector":
        return _tip_picture(effect, place, values, title)
    if effect.stage == "tool":
        return _tool_picture(effect, place, values, title)
    if effect.stage in ("joint", "sensor"):
        return _joint_picture(effect, values, title)
    return _drive_picture(effect, place, form, values, title)


def _drive_picture(effect: Effect, place: EffectPlace, form: Form, values: Values, title: str) -> str:
    time = np.arange(700) / RATE_HZ
    u = np.select(
        [time < 0.5, time < 2.5, time < 3.0, time < 4.0, time < 4.7],
        [0.0, 0.45 * (time - 0.5), 0.0, 0.8, 0.0],
        np.where(time < 6.3, -0.9 * np.sin(2 * np.pi * (time - 4.7) / 1.6), 0.0),
    )
    scale = 4.0 if effect.stage == "force" else 1.0
    recording = with_inputs(probe_recording(7.0), place.inputs, scale * np.tile(u[:, None], len(place.inputs)))
    run = plant_run(effect, place)
    driven = "slew" if effect.target == "machine" else place.target
    axis = probe_machine().axis(driven) if driven in probe_machine().axis_names else None
    follows = axis is not None and axis.actuation in ("position", "servo")  # its command is a position
    outputs = [run(v, recording)[:, 0] for v in (None, values)]
    gain = axis.gain if axis is not None and effect.stage != "force" else 1.0
    if not follows:
        outputs = [np.append(np.diff(output), np.nan) * RATE_HZ / gain for output in outputs]
    speed = "speed [m/s]" if effect.stage == "force" else "speed / speed at command 1"
    lines = [PictureCurve("without", time, outputs[0], GREY), PictureCurve("with", time, outputs[1], BLUE)]
    if follows:
        lines.insert(0, PictureCurve("command", time, recording.values(place.inputs[0]), ORANGE, dashed=True))
    elif effect.stage == "force":
        lines.insert(0, PictureCurve("force / 4 N", time, u, ORANGE, dashed=True))
    return svg(title, "time [s]", "position [rad]" if follows else speed, lines)


def _joint_picture(effect: Effect, values: Values, title: str) -> str:
    """The axis whose cylinder is measured: joint over time."""
    place = next(p for p in places_of(effect) if p.stage == "joint")
    time = np.arange(700) / RATE_HZ
    cylinder = 0.055 + 0.012 * np.sin(1.8 * time) + 0.006 * np.sin(4.1 * time)
    recording = with_inputs(probe_recording(7.0), place.inputs, cylinder[:, None])
    return _over_time(title, "joint [rad]", _first_outputs(effect, place, values, recording))


def _links_picture(effect: Effect, place: EffectPlace, values: Values, title: str) -> str:
    """Torque of the lifting joint over its angle, the elbow straight: at rest, and of friction in slow motion to and fro."""
    angle = np.linspace(-1.5, 1.5, 200)
    if place.stage == "friction":
        angle = -1.5 * np.cos(np.linspace(0.0, 2 * np.pi, 400))
    recording = with_inputs(probe_recording(2.0), place.inputs, np.column_stack([angle, 0.0 * angle]))
    run = plant_run(effect, place)
    named = (("without", None, GREY), ("with", values, BLUE))
    lines = [PictureCurve(label, angle, run(v, recording)[:, 0], colour) for label, v, colour in named]
    return svg(title, "angle of the lifting joint [rad]", "torque [N·m]", lines)


def _tip_picture(effect: Effect, place: EffectPlace, values: Values, title: str) -> str:
    """A loop of the arm seen from the side."""
    place = next((p for p in places_of(effect) if p.target == "boom"), place)
    angle = np.linspace(0.0, 2 * np.pi, 200)
    joints = np.column_stack([0.0 * angle, 0.5 + 0.3 * np.sin(angle), 0.15 * np.cos(angle), 0.3 - 0.8 * np.sin(angle + 0.6)])
    recording = with_inputs(probe_recording(2.0), place.inputs, joints)
    run = plant_run(effect, place)
    one, other = run(None, recording), run(values, recording)
    lines = [PictureCurve("without", one[:, 0], one[:, 2], GREY), PictureCurve("with", other[:, 0], other[:, 2], BLUE)]
    return svg(title, "x of the end effector [m]", "z [m]", lines, equal=True)


def _tool_picture(effect: Effect, place: EffectPlace, values: Values, title: str) -> str:
    time = np.arange(900) / RATE_HZ
    s = np.clip((time - 0.5) / 0.8, 0.0, 1.0)
    ee = np.column_stack([0.2 * (10 * s**3 - 15 * s**4 + 6 * s**5), np.zeros(900), np.ones(900)])
    table = {"time": time, **{name: ee[:, k] for k, name in enumerate(point_signals("ee"))}}
    recording = Recording("push", pd.DataFrame(table), RATE_HZ)
    return _over_time(title, "x of the tool [m]", _first_outputs(effect, place, values, recording))


#: Curves that differ by less than this share of their range coincide in the picture.
COINCIDE = 0.05


def _over_time(title: str, label: str, lines: Sequence[PictureCurve]) -> str:
    """Both curves, or their difference where they would coincide."""
    one, other = lines
    change = other.y - one.y
    if np.nanmax(np.abs(change)) < COINCIDE * np.ptp(one.y):
        label, lines = f"change of the {label}", (replace(one, y=0.0 * one.y), replace(other, y=change))
    return svg(title, "time [s]", label, lines)


def _first_outputs(effect: Effect, place: EffectPlace, values: Values, recording: Recording) -> list[PictureCurve]:
    """The first output of the stage over time, without and with the effect."""
    run, time = plant_run(effect, place), recording.values("time")
    named = (("without", None, GREY), ("with", values, BLUE))
    return [PictureCurve(label, time, run(v, recording)[:, 0], colour) for label, v, colour in named]


if __name__ == "__main__":
    write_documents(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/effects"))
