"""How functions that run in a loop are compiled: those of the plant, its effects and recurrent networks.

Counting references to arrays took more time than the mathematics, so what runs in a loop is compiled without it (Numba's
``_nrt=False``): such a function reads and writes the arrays that it is given and makes none.
"""

from __future__ import annotations

from typing import Any

from numba import njit

_BARE: Any = {"_nrt": False}

#: A step of an effect, or anything else that is called in every step: merged into its caller.
inlined: Any = njit(forceinline=True, error_model="numpy", fastmath={"contract"}, **_BARE)
#: A loop over samples or lanes, called from a :data:`kernel` that has made the arrays for it.
loop: Any = njit(nogil=True, error_model="numpy", fastmath={"contract"}, **_BARE)
#: What Python calls: kept between processes, and without the interpreter lock.
kernel: Any = njit(cache=True, nogil=True, error_model="numpy")
#: A kernel whose sums may be taken in any order, so that they run on several numbers at once.
summing: Any = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
