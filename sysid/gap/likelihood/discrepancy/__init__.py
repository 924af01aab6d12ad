"""Discrepancy of a plant from the machine: smooth functions in groups, whose variances are estimated.

    y = plant(θ) + Φ·β + …,     β_j ~ N(0, τ²_group(j))

Kennedy and O'Hagan (J. R. Statist. Soc. B 63, 2001) add such a discrepancy to a simulator; Brynjarsdóttir and O'Hagan (Inverse
Problems 30, 2014) show why it needs a prior, and why a parameter is overconfident without it. The functions of a group are the
tangents of every smooth effect of the catalogue and enough others of the same kind, so that a wrong effect does not compensate
for gaps of the basis. A group with a large variance shows on which variable the error depends.
"""

from __future__ import annotations

from sysid.gap.likelihood.discrepancy.basis import Discrepancy, discrepancy_of, timing_alone

__all__ = ["Discrepancy", "discrepancy_of", "timing_alone"]
