"""Interactive Plotly figures as data, which the page's script draws."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from sysid.files import plain

Array = npt.NDArray[np.float64]

#: Largest number of points of a curve: the resolution of a screen.
MAX_POINTS = 3000


def thin(values: Sequence[Array], limit: int = MAX_POINTS) -> list[Array]:
    """Every k-th row of arrays of equal length, so that at most ``limit`` rows remain."""
    step = max(1, -(-len(values[0]) // limit)) if values else 1
    return [np.asarray(column[::step], dtype=np.float64) for column in values]


def packed(values: Array) -> dict[str, str]:
    """The array as Plotly's typed-array JSON: 32-bit floats in base64, NaN for gaps."""
    return {"dtype": "f4", "bdata": base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii")}


def embed(identifier: str, value: Mapping[str, Any]) -> Markup:
    """A JSON element that the page's script reads; ``<`` is escaped so that no value can close the element."""
    text = json.dumps(plain(value), ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    return Markup('<script type="application/json" id="{}">{}</script>').format(identifier, Markup(text))


def figure(identifier: str, traces: Sequence[Mapping[str, Any]], layout: Mapping[str, Any], height: int = 340) -> Markup:
    """An interactive Plotly figure.

    Args:
        identifier: unique on the page.
        traces: Plotly traces; a colour given as ``$name`` is the page's CSS variable ``--name``.
        layout: Plotly layout without colours and fonts, which the page sets.
        height: [px].
    """
    island = embed(f"{identifier}-data", {"data": list(traces), "layout": dict(layout)})
    holder = Markup('<div class="figure" data-figure="{}" style="height:{}px"></div>').format(f"{identifier}-data", height)
    return Markup("").join([island, holder])
