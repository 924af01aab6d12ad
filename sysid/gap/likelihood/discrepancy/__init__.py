"""What the formulas of a plant cannot do: smooth functions in groups, whose variances the data give.

    y = plant(θ) + Φ·β + …,     β_j ~ N(0, τ²_group(j))

Kennedy and O'Hagan (J. R. Statist. Soc. B 63, 2001) add such a discrepancy to a simulator; Brynjarsdóttir and O'Hagan (Inverse
Problems 30, 2014) show why it needs a prior, and why a parameter is overconfident without it. The functions of a group are the
tangents of every smooth effect with a name and enough others of the same kind, so that a wrong effect cannot repair what the
basis lacks. A group whose variance comes out large says on what the disagreement depends.
"""

from __future__ import annotations

from sysid.gap.likelihood.discrepancy.basis import Discrepancy, discrepancy_of

__all__ = ["Discrepancy", "discrepancy_of"]
