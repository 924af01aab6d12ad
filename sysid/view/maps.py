"""Maps of the gap as bar charts of the viewer: mean of each bin, before and after the repair."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sysid.gap.result import Map

#: Largest number of maps per output, and the least share of the variance that they explain.
MAX_MAPS, MIN_EXPLAINED = 3, 0.15


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
    stream: Any, maps: Sequence[Map], colours: dict[str, tuple[int, int, int]], units: dict[str, tuple[float, str]]
) -> None:
    """Log the informative maps, valid at all times.

    Args:
        colours: of ``before`` and ``after``.
        units: SI unit → display factor and unit.
    """
    import rerun as rr

    for item in informative(maps):
        factor, _ = units.get(item.error_unit.removesuffix("/s"), (1.0, ""))
        across, _ = units.get(item.unit.removesuffix("/s"), (1.0, ""))
        at = across * np.array(item.at)
        for name, means in (("before", item.mean), ("after", item.after)):
            if means:
                bars = rr.BarChart(factor * np.array(means), abscissa=at, color=colours[name])
                rr.log(f"{entity(item)}/{name}", bars, static=True, recording=stream)


def map_views(maps: Sequence[Map]) -> list[Any]:
    """One tab for each output with informative maps."""
    import rerun.blueprint as rrb

    shown = informative(maps)
    return [
        rrb.Vertical(
            *(
                rrb.BarChartView(origin=entity(item), name=f"{item.quantity} over {item.over}")
                for item in shown
                if item.signal == signal
            ),
            name=f"map {signal}",
        )
        for signal in dict.fromkeys(item.signal for item in shown)
    ]
