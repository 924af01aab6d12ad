"""A policy in its own thread with a deadline: a cycle continues without an answer that is late.

No exception or answer of the policy ends the run. Python code that does not return is ended by an exception in its thread;
native code that does not return stays behind and does not prevent the process from ending. Native code that also keeps the
interpreter lock stops the loop: the machine's time-out closes the valves, and the cycle is too old to be sent when the loop
continues (:class:`sysid_rl.run.checks.settings.ExpiredCheck`).
"""

from __future__ import annotations

import contextlib
import ctypes
import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue

import numpy as np
import numpy.typing as npt

from sysid_rl.run.clock import SECOND
from sysid_rl.train.environment import Policy

Array = npt.NDArray[np.float64]

#: Deadline on a simulated clock, which does not advance during a computation [s].
SIMULATED_S = 2.0
#: Deadline of the first answer, which compiles and loads [s].
WARM_UP_S = 30.0
#: Longest text of an error [characters].
LONGEST = 200


class PolicyError(Exception):
    """The policy gave no valid answer; the text is the reason.

    Args:
        late: it missed its deadline, and may answer in another cycle.
    """

    def __init__(self, why: str, *, late: bool = False) -> None:
        super().__init__(why)
        self.late = late


class PolicyThread:
    """The thread of one policy.

    Args:
        policy: observations (1, O) → setpoints (1, A).
        axes: number A of setpoints.
    """

    def __init__(self, policy: Policy, axes: int) -> None:
        self.policy, self._axes = policy, axes
        self._requests: SimpleQueue[tuple[int, Array]] = SimpleQueue()
        self._answers: SimpleQueue[tuple[int, Array | BaseException]] = SimpleQueue()
        self._request_count = 0
        #: The request in progress; 0: none. Reset after an exception that ends an answer.
        self._at = 0
        self._thread: threading.Thread | None = None

    @property
    def native_id(self) -> int | None:
        """Thread identifier of the operating system; None before the first request."""
        return self._thread.native_id if self._thread is not None else None

    def ask(self, observations: Array, until_ns: int, now_ns: Callable[[], int]) -> Array:
        """Setpoints (A,) for observations (1, O), by ``until_ns`` on the clock ``now_ns``.

        Raises:
            PolicyError: no answer by then, another shape, or an exception of the policy.
        """
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="policy", daemon=True)
            self._thread.start()
        if self._at != 0 or not self._requests.empty():
            raise PolicyError("the policy is still at an earlier cycle", late=True)
        self._request_count += 1
        self._requests.put((self._request_count, observations.copy()))
        answer = self._wait(until_ns, now_ns)
        if isinstance(answer, PolicyError):
            if answer.late:
                self.cancel()  # at once: it competes with the loop for the interpreter
            raise answer
        if isinstance(answer, BaseException):
            raise PolicyError(f"the policy fails: {error_text(answer)}")
        return answer

    def cancel(self) -> None:
        """Discard the answer, and end Python code that is still running."""
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
                waits += 1 if now_ns() == begin else 2  # real time, or a simulated clock that stands still
            else:
                if number == self._request_count:  # not the answer to an earlier request
                    return answer
        return PolicyError("the policy does not answer within its cycle", late=True)

    def _work(self) -> None:
        while True:
            with contextlib.suppress(BaseException):  # cancelled outside of the policy's code
                self._at = 0
                number, observations = self._requests.get()
                self._at = number
                self._answer(number, observations)

    def _answer(self, number: int, observations: Array) -> None:
        answer: Array | BaseException
        try:
            answer = self._checked(self.policy.act(observations))
        except BaseException as error:  # SystemExit as well
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
    """An error in one line, with its class unless it is an error of the operating system."""
    try:
        text = " ".join(str(error).split())[:LONGEST]
    except Exception:  # the text of a foreign error may raise
        text = ""
    if isinstance(error, OSError) and text:
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
