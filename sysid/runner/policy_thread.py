"""A policy in a thread of its own, with a deadline: it answers within its cycle, or the cycle goes on without it.

Whatever it raises or returns ends no run. An answer that comes late is dropped. Python code that never ends is ended by an
exception in its thread; native code that never ends is left behind, and does not keep the process from ending. Native code that
also keeps the interpreter for itself stops the loop: the machine's own time-out closes the valves then, and the cycle is too
old to be sent when it goes on (:class:`sysid.runner.checks.settings.ExpiredCheck`).
"""

from __future__ import annotations

import contextlib
import ctypes
import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue

import numpy as np
import numpy.typing as npt

from sysid.rl.environment import Policy
from sysid.runner.clock import SECOND

Array = npt.NDArray[np.float64]

#: On a clock that stands still while somebody computes (a simulated one) a policy has so long [s].
SIMULATED_S = 2.0
#: Its first answer, which compiles and loads, may take so long [s].
WARM_UP_S = 30.0
#: An error's text is cut off here [characters].
LONGEST = 200


class PolicyError(Exception):
    """The policy gave no answer that can be used; the text says why.

    Args:
        late: because it was not there in time, and may be in another cycle.
    """

    def __init__(self, why: str, *, late: bool = False) -> None:
        super().__init__(why)
        self.late = late


class PolicyThread:
    """Of one policy.

    Args:
        policy: is asked.
        axes: how many setpoints it has to give.
    """

    def __init__(self, policy: Policy, axes: int) -> None:
        self.policy, self._axes = policy, axes
        self._requests: SimpleQueue[tuple[int, Array]] = SimpleQueue()
        self._answers: SimpleQueue[tuple[int, Array | BaseException]] = SimpleQueue()
        self._asked = 0
        #: The question that the thread is at; 0: none. An exception may end an answer anywhere: this is right again after it.
        self._at = 0
        self._thread: threading.Thread | None = None

    @property
    def native_id(self) -> int | None:
        """Of the thread, for the operating system; None while there is none."""
        return self._thread.native_id if self._thread is not None else None

    @property
    def _busy(self) -> bool:
        return self._at != 0 or not self._requests.empty()

    def ask(self, observations: Array, until_ns: int, now_ns: Callable[[], int]) -> Array:
        """Setpoints (A,) for observations (1, O), by ``until_ns`` on the clock ``now_ns``.

        Raises:
            PolicyError: none by then, none of this shape, or what the policy raised.
        """
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="policy", daemon=True)
            self._thread.start()
        if self._busy:
            raise PolicyError("the policy is still at an earlier cycle", late=True)
        self._asked += 1
        self._requests.put((self._asked, observations.copy()))
        answer = self._wait(until_ns, now_ns)
        if isinstance(answer, PolicyError):
            if answer.late:
                self.cancel()  # at once: Python code that computes takes turns with the loop, which needs the rest of this one
            raise answer
        if isinstance(answer, BaseException):
            raise PolicyError(f"the policy fails: {error_text(answer)}")
        return answer

    def cancel(self) -> None:
        """Nobody waits for the answer any more: Python code that is still at it is ended."""
        thread = self._thread
        if self._at and thread is not None and thread.ident is not None:
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident), ctypes.py_object(SystemExit))

    def _wait(self, until_ns: int, now_ns: Callable[[], int]) -> Array | BaseException:
        begin, waits = now_ns(), 0
        while waits < 2:
            left = (until_ns - now_ns()) / SECOND if waits == 0 else SIMULATED_S
            try:
                number, answer = self._answers.get(timeout=max(left, 0.0))
            except Empty:
                waits += 1 if now_ns() == begin else 2  # time passes by itself, or stands still while somebody computes
            else:
                if number == self._asked:  # not one of a cycle that is over
                    return answer
        return PolicyError("the policy does not answer within its cycle", late=True)

    def _work(self) -> None:
        while True:
            with contextlib.suppress(BaseException):  # cancelled outside of the policy's own code
                self._at = 0
                number, observations = self._requests.get()
                self._at = number
                self._answer(number, observations)

    def _answer(self, number: int, observations: Array) -> None:
        answer: Array | BaseException
        try:
            answer = self._checked(self.policy.act(observations))
        except BaseException as error:  # even what ends a program ends no run
            answer = error
        self._answers.put((number, answer))

    def _checked(self, answer: object) -> Array:
        if not isinstance(answer, np.ndarray):
            raise PolicyError(f"the policy answers with {type(answer).__name__}, expected an array (1, {self._axes})")
        if answer.dtype.kind not in "fiu" or answer.shape != (1, self._axes):
            found = f"{answer.dtype} {answer.shape}"
            raise PolicyError(f"the policy answers with {found}, expected numbers (1, {self._axes})")
        return np.array(answer[0], dtype=np.float64)


def error_text(error: BaseException) -> str:
    """An error on one line, with its kind where the text is not that of the system."""
    try:
        text = " ".join(str(error).split())[:LONGEST]
    except Exception:  # an error of somebody else's, whose text is one more
        text = ""
    if isinstance(error, OSError) and text:
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
