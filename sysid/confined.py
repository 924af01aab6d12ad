"""A file is read in a process of its own, with limits on its address space and its processor time.

With a damaged or malicious file, a library may allocate memory without limit, never return, or crash. In a process of its own
this is an error of the file only. Results return through a pipe: values as JSON, arrays as bytes; nothing in it can run code.
With scratch files (:mod:`sysid.scratch`) large arrays return in one that the process has written, without a copy.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import json
import os
import resource
import select
import signal
import struct
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np
import numpy.typing as npt

from sysid import errors, scratch
from sysid.errors import InputError, SysidError
from sysid.scratch import Scratch, ScratchSegment

T = TypeVar("T")

#: Address space beyond the limit: room that threads and allocators reserve without using it.
_RESERVED = 256 * 2**20
#: Longest wait, as a multiple of the allowed processor time: the machine may be busy.
_WAITING = 40.0
#: A message: its kind (progress, result, error) and the length of its text.
_HEAD = struct.Struct("<cQ")
_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG
_DAMAGED = "The file is damaged or malicious."
_inside = False


@dataclass(frozen=True)
class Limits:
    """Limits of one process.

    Args:
        memory: address space in addition to that of the parent [B].
        seconds: processor time [s].
        what: kind of file that is read, for messages.
        smaller: what to do with a file that is larger and sound, for messages.
    """

    memory: int
    seconds: float
    what: str = "a log"
    smaller: str = "export it in parts"

    def exceeded(self, where: object, seconds: bool) -> InputError:
        """The error of a file that takes more than the memory, or than the ``seconds``."""
        found = f"takes more than {self.seconds:.0f} s" if seconds else f"takes more than {self.memory / 2**20:.0f} MiB to read"
        remedy = f"The file is damaged or malicious; if it is neither, {self.smaller}."
        return InputError(where, found, f"what {self.what} of its size takes", remedy)


def inside() -> bool:
    """Whether this process is a confined one, in which a file can be read without another."""
    return _inside


def confined(
    work: Callable[[Callable[[float], None]], T],
    where: object,
    limits: Limits,
    kinds: Sequence[type],
    progress: Callable[[float], None] = lambda share: None,
) -> T:
    """The result of ``work``: text, numbers, arrays, paths, and dataclasses of ``kinds``, nested in tuples and dictionaries.

    Args:
        work: called in the child process with a function that takes the share done.
        where: of the error where a limit is exceeded or the process crashes.
        progress: called in this process with the share done.

    Raises:
        SysidError, OSError, ModuleNotFoundError: as ``work`` raises them.
        InputError: a limit is exceeded, ``work`` raises anything else, or the process crashes.
    """
    own = scratch.current()
    shared = Scratch(own.folder) if own is not None else None
    file = shared.file if shared is not None else None  # opened here, so that both processes have it
    outlet, inlet = os.pipe()
    with own.unshared() if own is not None else contextlib.nullcontext():
        child = os.fork()
        if child == 0:
            os.close(outlet)
            _work(work, inlet, limits, kinds, shared)
    os.close(inlet)
    status: int | None = None
    try:
        answer = _Answer(outlet, _WAITING * limits.seconds, None if file is None else file.fileno())
        while True:
            kind, text = answer.message()
            if kind == b"P":
                progress(float(json.loads(text)))
            elif kind == b"R":
                value: T = answer.value(json.loads(text), {kind.__name__: kind for kind in kinds})
                return value
            else:
                raise _raised(json.loads(text), where, limits)
    except EOFError:
        _, status = os.waitpid(child, 0)
        raise _ended(status, where, limits) from None
    except TimeoutError:
        raise limits.exceeded(where, seconds=True) from None
    finally:
        os.close(outlet)
        if shared is not None:
            shared.close()
        if status is None:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)


def _work(
    work: Callable[[Callable[[float], None]], Any], inlet: int, limits: Limits, kinds: Sequence[type], shared: Scratch | None
) -> NoReturn:
    """The child process, which ends here. Its large arrays are in the file of ``shared``."""
    with contextlib.suppress(BaseException):
        _confine(limits)
        try:
            description = _Description(tuple(kinds))
            with contextlib.nullcontext() if shared is None else scratch.used(shared):
                value = description.of(work(lambda share: _send(inlet, b"P", share)))
            arrays = description.arrays
            places = [None if shared is None else shared.place(array) for array in arrays]
            heads = [[array.dtype.str, len(array), array.flags.writeable] for array in arrays]
            _send(inlet, b"R", [value, [[*head, place] for head, place in zip(heads, places, strict=True)]])
            for array, place in zip(arrays, places, strict=True):
                if len(array) and place is None:
                    _write(inlet, np.ascontiguousarray(array).data.cast("B"))
        except SysidError as error:
            kind = next(kind for kind in type(error).__mro__ if kind.__module__ == errors.__name__)
            _send(inlet, b"E", [kind.__name__, error.where, error.found, error.expected, error.remedy])
        except MemoryError:
            _send(inlet, b"E", ["MemoryError"])
        except OSError as error:
            filename = None if error.filename is None else str(error.filename)
            _send(inlet, b"E", ["OSError", error.errno, error.strerror, filename])
        except ModuleNotFoundError as error:
            _send(inlet, b"E", ["ModuleNotFoundError", str(error), error.name])
        except Exception as error:
            _send(inlet, b"E", ["Exception", f"{type(error).__name__}: {error}"])
    os._exit(0)


def _confine(limits: Limits) -> None:
    global _inside
    _inside = True
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN if number == signal.SIGINT else signal.SIG_DFL)  # the parent ends it
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, int(signal.SIGKILL))
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nowhere, stream)
    os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"  # others reserve a gigabyte of address space at once
    if "pyarrow" in sys.modules:
        import pyarrow as pa

        pa.set_memory_pool(pa.system_memory_pool())
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    faulthandler.disable()  # the parent reports a crash
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    seconds = max(1, round(limits.seconds))
    for what, soft, limit in (
        (resource.RLIMIT_AS, taken + limits.memory + _RESERVED, taken + limits.memory + _RESERVED),
        (resource.RLIMIT_CPU, seconds, seconds + 5),  # SIGXCPU at the first, SIGKILL at the second
    ):
        hard = resource.getrlimit(what)[1]
        most = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(what, (min(soft, most), most))


def _send(inlet: int, kind: bytes, value: Any) -> None:
    text = json.dumps(value).encode()
    _write(inlet, memoryview(_HEAD.pack(kind, len(text)) + text))


def _write(inlet: int, data: memoryview) -> None:
    while len(data):
        data = data[os.write(inlet, data[: 2**20]) :]


@dataclass
class _Description:
    """Encodes values as JSON types. An array is encoded by its index in ``arrays``, which holds each array once."""

    kinds: tuple[type, ...]
    arrays: list[npt.NDArray[Any]] = field(default_factory=list)
    places: dict[int, int] = field(default_factory=dict)

    def of(self, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            if id(value) not in self.places:
                self.places[id(value)] = len(self.arrays)
                self.arrays.append(value)
            return {"array": self.places[id(value)]}
        if is_dataclass(value) and isinstance(value, self.kinds):
            return {"kind": type(value).__name__, "of": {f.name: self.of(getattr(value, f.name)) for f in fields(value)}}
        if isinstance(value, Mapping):
            return {"pairs": [[self.of(key), self.of(item)] for key, item in value.items()]}
        if isinstance(value, tuple | list):
            return {"items": [self.of(item) for item in value]}
        if isinstance(value, Path):
            return {"path": str(value)}
        return value.item() if isinstance(value, np.generic) else value


def _value(described: Any, arrays: Sequence[npt.NDArray[Any]], kinds: Mapping[str, type]) -> Any:
    """Decodes what :class:`_Description` has encoded; lists become tuples."""

    def inner(item: Any) -> Any:
        return _value(item, arrays, kinds)

    match described:
        case {"array": place}:
            return arrays[place]
        case {"kind": name, "of": dict(members)}:
            return kinds[name](**{key: inner(item) for key, item in members.items()})
        case {"pairs": list(pairs)}:
            return {inner(key): inner(item) for key, item in pairs}
        case {"items": list(items)}:
            return tuple(map(inner, items))
        case {"path": str(path)}:
            return Path(path)
    return described


@dataclass
class _Answer:
    """Messages from the pipe, with a total waiting time of ``seconds``, and arrays in the scratch ``file``."""

    pipe: int
    seconds: float
    file: int | None = None

    def message(self) -> tuple[bytes, bytes]:
        """Kind and text of the next message.

        Raises:
            EOFError: the process has ended.
            TimeoutError: nothing came in time.
        """
        kind, length = _HEAD.unpack(self._bytes(_HEAD.size))
        return kind, self._bytes(length)

    def value(self, result: Any, kinds: Mapping[str, type]) -> Any:
        """The value of a result, whose arrays follow in the pipe or are in the file."""
        described, listed = result
        arrays = []
        segment: ScratchSegment | None = None
        for code, count, writeable, place in listed:
            if place is None:
                array = scratch.empty(count, np.dtype(code))
                self._fill(array.data.cast("B") if count else memoryview(b""))
            else:
                segment = self._mapped() if segment is None else segment
                array = segment.array(place, count, code)  # NumPy refuses one that reaches beyond the file
            array.setflags(write=writeable)
            arrays.append(array)
        return _value(described, arrays, kinds)

    def _mapped(self) -> ScratchSegment:
        own = scratch.current()
        if own is None or self.file is None:
            raise ValueError("an array in a scratch file that there is not")
        segment = ScratchSegment(self.file, 0, os.fstat(self.file).st_size)
        own.adopt(segment)
        return segment

    def _bytes(self, count: int) -> bytes:
        buffer = bytearray(count)
        self._fill(memoryview(buffer))
        return bytes(buffer)

    def _fill(self, view: memoryview) -> None:
        waiting = select.poll()
        waiting.register(self.pipe, select.POLLIN)
        while len(view):
            before = time.monotonic()
            if self.seconds <= 0.0 or not waiting.poll(1e3 * self.seconds):
                raise TimeoutError
            self.seconds -= time.monotonic() - before
            count = os.readv(self.pipe, [view])
            if not count:
                raise EOFError
            view = view[count:]


def _raised(sent: Sequence[Any], where: object, limits: Limits) -> Exception:
    """The error that the child process raised."""
    name, *rest = sent
    if name == "MemoryError":
        return limits.exceeded(where, seconds=False)
    if name == "OSError":
        return OSError(*rest)
    if name == "ModuleNotFoundError":
        return ModuleNotFoundError(rest[0], name=rest[1])
    kind = getattr(errors, name, None)
    if isinstance(kind, type) and issubclass(kind, SysidError):
        return kind(*rest)
    return InputError(where, f"cannot be read ({rest[0]})", f"{limits.what} of its format", _DAMAGED)


def _ended(status: int, where: object, limits: Limits) -> InputError:
    """Why the child process ended without a result."""
    number = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
    if number == signal.SIGXCPU:
        return limits.exceeded(where, seconds=True)
    if number in (signal.SIGKILL, 0):
        return limits.exceeded(where, seconds=False)
    return InputError(where, f"the reader crashed (signal {number})", f"{limits.what} of its format", _DAMAGED)
