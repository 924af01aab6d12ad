"""How many clocks are aligned, and which are not, as one sentence for the report and the pages of a workspace."""

from __future__ import annotations

from collections.abc import Iterable

#: An offset whose 95 % interval is wider than this is of no use at the usual rate of 100 Hz: half a sample [s].
COARSE_S = 0.005


def clock_summary(clocks: Iterable[tuple[str, bool, float]]) -> str:
    """The sentence.

    Args:
        clocks: recording, whether its offset was applied, and half of the 95 % interval of the offset [s].
    """
    rows = list(clocks)
    fine = sum(applied and half <= COARSE_S for _, applied, half in rows)
    coarse = [name for name, applied, half in rows if applied and half > COARSE_S]
    left = [name for name, applied, _ in rows if not applied]
    parts = [f"{fine} of {len(rows)} clocks are aligned to within {1e3 * COARSE_S:.0f} ms"]
    parts += [f"{', '.join(coarse)}: known less exactly"] if coarse else []
    parts += [f"{', '.join(left)}: not aligned"] if left else []
    return "; ".join(parts) + "."
