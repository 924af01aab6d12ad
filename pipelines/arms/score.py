"""Scores one answer against the truth of its case."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import signal

from arms.names import ACCEPTED, RESONANCE, Accepted

#: Cut-offs [Hz] of force and position, where the answer does not state them, and order of the workflow's force filter, which is
#: Butterworth forward and backward (sysid/plant/force.py).
FORCE_HZ, POSITION_HZ, ORDER = 10.0, 50.0, 4
#: Highest cut-off [share of the rate].
HIGHEST = 0.4
#: A resonance counts as described within this relative error.
RESONANCE_ERROR = 0.1

Name = tuple[str, str]


@dataclass(frozen=True)
class CaseScore:
    """One case.

    Args:
        variant: of the row, empty where it has none.
        outcome: ``right`` (all that is due is named, nothing else), ``incomplete`` (something due is missing, or named in a
            simpler form), ``none`` (no name), ``wrong``, ``refused`` (an error of the workflow) or ``failure`` (a crash).
        verdict: of the workflow.
        missed: due and not named; ``coarse``: named in a simpler form.
        errors: relative error by ``effect(target).parameter``.
        ratio: held-out error of the repaired plant over that of the truth, which is sensor noise; of the worst signal.
        stated: the same over the noise floor that the answer states.
        resonance: relative error of a resonance that was described without a name.
        tie: of a sagging servo without masses: whether bias and compliance are reported as a tie for every sagging axis.
        planned: whether the answer says what to record next.
        spread: standard deviation that masses known to 5 % leave of the payload's mass, relative.
        reason: of a refusal or failure.
    """

    row: str
    case: str
    variant: str
    outcome: str
    verdict: str
    named: tuple[Name, ...] = ()
    wrong: tuple[Name, ...] = ()
    missed: tuple[Name, ...] = ()
    coarse: tuple[Name, ...] = ()
    errors: dict[str, float] = field(default_factory=dict)
    ratio: float | None = None
    stated: float | None = None
    resonance: float | None = None
    tie: bool | None = None
    planned: bool = False
    spread: float | None = None
    seconds: float | None = None
    wall_seconds: float | None = None
    reason: str = ""

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def score_case(folder: Path) -> CaseScore:
    """The score of a case from its ``truth.json`` and ``answer.json``."""
    truth = json.loads((folder / "truth.json").read_text("utf-8"))
    answered = json.loads((folder / "answer.json").read_text("utf-8"))
    return score(truth, answered)


def score(truth: Mapping[str, Any], answered: Mapping[str, Any]) -> CaseScore:
    """Compare an answer with the truth."""
    variant = truth.get("variant", truth.get("kind", "eleven" if truth.get("joints") == 11 else ""))
    about = {"row": truth["row"], "case": truth["name"], "variant": variant}
    times = {key: answered.get(key) for key in ("seconds", "wall_seconds")}
    for key, outcome in (("failure", "failure"), ("refused", "refused")):
        if key in answered:
            return CaseScore(**about, outcome=outcome, verdict=outcome, reason=answered[key], **times)
    answer = answered["answer"]
    matched: dict[int, tuple[Mapping[str, Any], Accepted]] = {}
    wrong, errors = [], {}
    for effect in answer["effects"]:
        found = _match(effect, truth["hidden"])
        if found is None:
            wrong.append((effect["name"], effect["target"]))
            continue
        index, accepted = found
        # The finer of two names of one hidden effect counts.
        if index not in matched or matched[index][1].coarse:
            matched[index] = effect, accepted
        errors |= _errors(effect, accepted, truth["hidden"][index])
    due = [k for k, each in enumerate(truth["hidden"]) if each["due"]]
    missed = tuple(_name(truth["hidden"][k]) for k in due if k not in matched)
    coarse = tuple(_name(truth["hidden"][k]) for k in due if k in matched and matched[k][1].coarse)
    named = tuple((effect["name"], effect["target"]) for effect in answer["effects"])
    complete = not missed and not coarse
    outcome = "wrong" if wrong else "right" if complete else "incomplete" if named else "none"
    ratio, stated = _ratios(truth, answer)
    return CaseScore(
        **about,
        outcome=outcome,
        verdict=answer["verdict"],
        named=named,
        wrong=tuple(wrong),
        missed=missed,
        coarse=coarse,
        errors=errors,
        ratio=ratio,
        stated=stated,
        resonance=_resonance(truth, answer),
        tie=_tie(truth["sagging"], answer) if variant == "plain" else None,
        planned=bool(answer["next_experiment"]),
        spread=_spread(truth),
        **times,
    )


def _name(hidden: Mapping[str, Any]) -> Name:
    return hidden["name"], hidden["target"]


def _match(effect: Mapping[str, Any], hidden: list[Mapping[str, Any]]) -> tuple[int, Accepted] | None:
    """Which hidden effect a named one is, under its own name or an exact alias."""
    names = [(effect["name"], effect["target"]), *((a["name"], a["target"]) for a in effect.get("aliases") or ())]
    candidates = [
        (index, accepted)
        for index, each in enumerate(hidden)
        for accepted in ACCEPTED[each["name"]]
        for name, target in names
        if name == accepted.name and (target == each["target"] or accepted.anywhere)
    ]
    return min(candidates, key=lambda pair: pair[1].coarse, default=None)


def _errors(effect: Mapping[str, Any], accepted: Accepted, hidden: Mapping[str, Any]) -> dict[str, float]:
    """Relative error by ``effect(target).parameter``; of vectors the largest component sets the scale."""
    found = {}
    for key, true_key in accepted.parameters.items():
        value = _parameter(effect["parameters"], key)
        if value is None or true_key not in hidden["parameters"]:
            continue
        estimate, true = np.atleast_1d(value), np.atleast_1d(hidden["parameters"][true_key])
        if estimate.shape == true.shape:
            found[f"{effect['name']}({effect['target']}).{key}"] = float(np.abs(estimate - true).max() / np.abs(true).max())
    return found


def _parameter(parameters: Mapping[str, Any], key: str) -> Any:
    """A parameter; the mean of both directions where they have their own."""
    if key not in parameters and {"positive", "negative"} <= parameters.keys():
        return 0.5 * (parameters["positive"] + parameters["negative"])
    return parameters.get(key)


def _ratios(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Held-out error over the truth's own error and over the stated floor, of the worst signal of the row."""
    after, stated = answer["gap"]["after"], answer["gap"]["noise_floor"]
    if "tip_noise" in truth:
        signals = [f"ee.{letter}" for letter in "xyz"]
        if not all(name in after for name in signals):
            return None, None
        error = math.sqrt(sum(after[name] ** 2 for name in signals) / 3.0)
        floor = math.sqrt(sum(stated[name] ** 2 for name in signals) / 3.0)
        return error / truth["tip_noise"], error / floor if floor else None
    if "encoder_noise" in truth:
        joints = [name for name in after if name.endswith(".joint")]
        return (
            max((after[name] / truth["encoder_noise"] for name in joints), default=None),
            max((after[name] / stated[name] for name in joints), default=None),
        )
    bands = {item["axis"]: (item["bandwidth_hz"], item["position_hz"]) for item in answer.get("forces", ())}
    ratios, stated_ratios = [], []
    for axis, noise in truth.get("torque_noise", {}).items():
        name = f"{axis}.command"
        if name not in after:
            continue
        share, acceleration = noise_shares(truth["rate_hz"], *bands.get(axis, (FORCE_HZ, POSITION_HZ)))
        own = math.hypot(share * noise, acceleration * truth["joint_noise"] * truth["inertia"][axis])
        ratios.append(after[name] / own)
        if stated.get(name):
            stated_ratios.append(after[name] / stated[name])
    return max(ratios, default=None), max(stated_ratios, default=None)


def noise_shares(rate_hz: float, force_hz: float, position_hz: float) -> tuple[float, float]:
    """Standard deviations behind the force filter for white noise of one unit: of the force, and of the acceleration by
    differentiation of a position with this noise."""
    frequency = np.linspace(0.0, 0.5 * rate_hz, 1 << 14)

    def gain(hz: float) -> npt.NDArray[np.float64]:
        sos = signal.butter(ORDER, min(hz, HIGHEST * rate_hz), fs=rate_hz, output="sos")
        # Forward and backward: |H|² in amplitude.
        return np.asarray(np.abs(signal.sosfreqz(sos, worN=frequency, fs=rate_hz)[1]) ** 2)

    force = gain(force_hz)
    acceleration = force * gain(position_hz) * (2.0 * math.pi * frequency) ** 2
    return float(np.sqrt(np.mean(force**2))), float(np.sqrt(np.mean(acceleration**2)))


def _resonance(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> float | None:
    """Smallest relative error of a resonance or antiresonance among the unnamed residuals."""
    true = [each["parameters"] for each in truth["hidden"] if each["name"].startswith("flexible_drive")]
    stated = [item[key] for item in answer["unnamed"] for key in RESONANCE if isinstance(item.get(key), float | int)]
    goals = [parameters[key] for parameters in true for key in ("antiresonance_hz", "resonance_hz")]
    return min((abs(value / goal - 1.0) for value in stated for goal in goals), default=None)


def _tie(sagging: list[str], answer: Mapping[str, Any]) -> bool:
    """Whether each sagging axis has a tie between compliance and bias."""
    ties = [{(item["name"], item["target"].split(".")[0]) for item in group} for group in answer["ambiguous"]]
    return all(any({("joint_compliance", axis), ("sensor_bias", axis)} <= tie for tie in ties) for axis in sagging)


def _spread(truth: Mapping[str, Any]) -> float | None:
    carried = [each["parameters"]["mass"] for each in truth["hidden"] if each["name"] == "payload"]
    return truth["payload_spread"] / carried[0] if carried else None
