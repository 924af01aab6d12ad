"""Maps of the gap as line charts: mean error over a variable, before and after the repair, with ticks, units and words.

The viewer has no chart over another axis than time, so that curves, axes and labels are drawn as lines and points in a plane.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.gap.result import Map
from sysid.pictures import ticks

Array = npt.NDArray[np.float64]

#: Largest number of maps per output, and the least share of the variance that they explain.
MAX_MAPS, MIN_EXPLAINED = 3, 0.15
#: Size of a chart in its plane, and its margin for labels.
WIDTH, HEIGHT, MARGIN = 520.0, 130.0, 30.0
GREY, FAINT, BAND = (130, 138, 146), (90, 96, 102), (70, 76, 82)


def informative(maps: Sequence[Map]) -> list[Map]:
    """The maps of each output that explain most of its gap, in the order of the outputs."""
    found = []
    for signal in dict.fromkeys(item.signal for item in maps):
        of_signal = sorted((item for item in maps if item.signal == signal), key=lambda item: -item.explains)
        found += [item for item in of_signal if item.explains > MIN_EXPLAINED][:MAX_MAPS]
    return found


def entity(item: Map) -> str:
    """Entity path of a map."""
    return "/".join(("maps", item.signal, item.quantity.replace(" ", "_"), item.over.replace(" ", "_")))


def log_maps(
    stream: Any, maps: Sequence[Map], colours: Mapping[str, tuple[int, int, int]], units: Mapping[str, tuple[float, str]]
) -> None:
    """Log the informative maps, valid at all times.

    Args:
        colours: of ``before`` and ``after``.
        units: SI unit → display factor and unit.
    """
    for item in informative(maps):
        factor, label = _shown(item.error_unit, units)
        across, unit = _shown(item.unit, units)
        curves = {"before": factor * np.array(item.mean), "after": factor * np.array(item.after)}
        curves = {name: values for name, values in curves.items() if len(values)}
        words = (f"{item.over} [{unit}]" if unit else item.over, f"{item.quantity} of {item.signal} [{label}]")
        _log_chart(stream, entity(item), across * np.array(item.at), curves, 2.0 * factor * item.noise_floor, words, colours)


def map_views(maps: Sequence[Map]) -> list[Any]:
    """One tab for each output with informative maps."""
    import rerun.blueprint as rrb

    shown = informative(maps)
    bounds = rrb.VisualBounds2D(x_range=[-MARGIN, WIDTH + 2.0 * MARGIN], y_range=[-MARGIN, HEIGHT + 2.2 * MARGIN])
    return [
        rrb.Vertical(
            *(
                rrb.Spatial2DView(origin=entity(item), name=f"{item.quantity} over {item.over}", visual_bounds=bounds)
                for item in shown
                if item.signal == signal
            ),
            name=f"map {signal}",
        )
        for signal in dict.fromkeys(item.signal for item in shown)
    ]


def _log_chart(
    stream: Any,
    path: str,
    x: Array,
    curves: Mapping[str, Array],
    noise: float,
    words: tuple[str, str],
    colours: Mapping[str, tuple[int, int, int]],
) -> None:
    import rerun as rr

    values = np.concatenate([*curves.values(), np.array([-noise, noise])])
    ends = [(float(np.nanmin(own)), float(np.nanmax(own))) for own in (x, values)]
    (left, right), (low, high) = [(a, b) if b > a else (a - 0.5, a + 0.5) for a, b in ends]

    def place(a: Array, b: Array) -> Array:
        return np.column_stack([WIDTH * (a - left) / (right - left), HEIGHT * (high - b) / (high - low)])

    def log(name: str, value: Any) -> None:
        rr.log(f"{path}/{name}", value, static=True, recording=stream)

    edges = np.array([left, right])
    frame = [place(np.array([left, left, right]), np.array([high, low, low])), place(edges, np.zeros(2))]
    log("axes", rr.LineStrips2D(frame[: 2 if low < 0.0 < high else 1], colors=[GREY, FAINT], radii=0.4))
    if noise > 0.0:
        log("noise", rr.LineStrips2D([place(edges, np.full(2, side)) for side in (-noise, noise)], colors=[BAND], radii=0.3))
    across, up = ticks(left, right), ticks(low, high)
    at = [*place(np.array(across), np.full(len(across), low)), *place(np.full(len(up), left), np.array(up))]
    texts = [f"{value:.4g}" for value in (*across, *up)]
    log("ticks", rr.Points2D(at, labels=texts, colors=[GREY], radii=1.0, show_labels=True))
    titles = np.array([[WIDTH / 2.0, HEIGHT + MARGIN], [WIDTH / 2.0, -MARGIN / 2.0]])
    log("words", rr.Points2D(titles, labels=list(words), colors=[GREY], radii=0.1, show_labels=True))
    for name, own in curves.items():
        known = np.isfinite(own) & np.isfinite(x)
        points = place(x[known], own[known])
        log(name, rr.LineStrips2D([points], colors=[colours[name]], radii=0.8))
        log(f"{name}/bins", rr.Points2D(points, colors=[colours[name]], radii=1.6))
        end = points[-1:] + np.array([[MARGIN, 0.0]]) if len(points) else points
        log(f"{name}/name", rr.Points2D(end, labels=[name], colors=[colours[name]], radii=0.1, show_labels=True))


def _shown(unit: str, units: Mapping[str, tuple[float, str]]) -> tuple[float, str]:
    """Display factor and unit; of a rate those of its signal."""
    factor, label = units.get(unit.removesuffix("/s"), (1.0, unit.removesuffix("/s").removesuffix("1")))
    return factor, f"{label or 1}/s" if unit.endswith("/s") else label
