"""Numba decorators of the plant, its effects and recurrent networks.

Functions in a loop are compiled without reference counting (Numba's ``_nrt=False``), which would take longer than the
mathematics. Such a function reads and writes its arguments and allocates no arrays.
"""

from __future__ import annotations

from typing import Any

from numba import njit

_BARE: Any = {"_nrt": False}

#: A function that is called in every step, such as a step of an effect: inlined into its caller.
inlined: Any = njit(forceinline=True, error_model="numpy", fastmath={"contract"}, **_BARE)
#: A loop over samples or lanes, called from a :data:`kernel` that allocates its arrays.
loop: Any = njit(nogil=True, error_model="numpy", fastmath={"contract"}, **_BARE)
#: Entry point from Python: cached between processes, releases the interpreter lock.
kernel: Any = njit(cache=True, nogil=True, error_model="numpy")
#: A kernel whose sums may be reordered (vectorised).
summing: Any = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
