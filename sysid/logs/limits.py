"""How much a log file may ask for. A damaged or hostile file must not fill the memory, so every size it states is checked."""

from __future__ import annotations

from pathlib import Path

from sysid.errors import InputError

#: A chunk of a log larger than this when unpacked is left out.
MAX_CHUNK = 512 * 2**20
#: Packed data that grow by more than this beyond :data:`FREE` are a bomb, not a log.
MAX_RATIO, FREE = 1000, 16 * 2**20
#: Text exports and tables are read whole.
MAX_TEXT = 4 * 2**30
#: Numbers in a table that is read whole.
MAX_CELLS = 2**29


def check_whole(path: Path, what: str, limit: int = MAX_TEXT) -> None:
    """Raise where ``path`` is missing, empty, or too large to be read whole.

    Raises:
        InputError: no such file, no bytes, more than ``limit`` bytes.
    """
    if not path.is_file():
        raise InputError(path, "no such file", what, "Check the path.")
    size = path.stat().st_size
    if size == 0:
        raise InputError(path, "the file is empty", what, "Export the log again.")
    if size > limit:
        raise InputError(path, f"{size / 2**30:.1f} GiB", f"at most {limit / 2**30:g} GiB for {what}", "Export it in parts.")


def too_large(packed: int, unpacked: int, limit: bool = True) -> str:
    """Why ``packed`` bytes may not be unpacked to ``unpacked`` bytes; empty where they may.

    ``limit``: at once, as one chunk.
    """
    if limit and unpacked > MAX_CHUNK:
        return f"unpacks to {unpacked / 2**20:.0f} MiB, more than {MAX_CHUNK / 2**20:.0f} MiB"
    if unpacked > max(FREE, packed * MAX_RATIO):
        return f"{packed} bytes unpack to {unpacked}, more than {MAX_RATIO} times as many"
    return ""


def unpack(packed: bytes | memoryview, compression: str, size: int, cut_off: bool = False) -> bytes:
    """The ``size`` bytes that were compressed with zstd or lz4 (frames); fewer where the data are cut off.

    Raises:
        ValueError: the data are damaged, or larger than they say, or larger than allowed.
    """
    reason = too_large(len(packed), size)
    if reason:
        raise ValueError(reason)
    if compression == "zstd":
        return _unzstd(packed, size, cut_off)
    if compression == "lz4":
        return _unlz4(packed, size, cut_off)
    raise ValueError(f"compressed with {compression!r}; zstd, lz4 or none can be read")


def _unzstd(packed: bytes | memoryview, size: int, cut_off: bool) -> bytes:
    import zstandard

    pieces: list[bytes] = []
    left = size + 1
    try:
        stated = zstandard.frame_content_size(packed)
        if stated == size and not cut_off:
            return zstandard.ZstdDecompressor().decompress(packed)
        # Not told how large it is, or lied to: never more than the size that was allowed.
        with zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as reader:
            while left > 0 and (piece := reader.read(min(left, 2**20))):
                pieces.append(piece)
                left -= len(piece)
    except zstandard.ZstdError as error:
        if not cut_off:
            raise ValueError(str(error)) from None
    return _checked(b"".join(pieces), size, cut_off)


def _unlz4(packed: bytes | memoryview, size: int, cut_off: bool) -> bytes:
    import lz4.frame  # type: ignore[import-untyped]

    try:
        data = bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1))
    except RuntimeError as error:
        raise ValueError(str(error)) from None
    return _checked(data, size, cut_off)


def _checked(data: bytes, size: int, cut_off: bool) -> bytes:
    if len(data) > size:
        raise ValueError(f"more than the {size} bytes that the file states")
    if len(data) < size and not cut_off:
        raise ValueError(f"{len(data)} bytes instead of the {size} that the file states")
    return data
