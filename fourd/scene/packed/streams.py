"""Members of a packed scene: byte planes compressed with Zstandard (RFC 8878) or zlib (RFC 1950).

zlib is for web browsers, which cannot decompress Zstandard. The first bytes of a member show which compression was
used.
"""

from __future__ import annotations

import zlib
from typing import Literal

import numpy as np
import zstandard
from numpy.typing import NDArray

Compression = Literal["zstd", "zlib"]
"""Compression format of the members of a file."""

LEVEL, ZLIB_LEVEL = 19, 9
"""Compression levels of Zstandard and zlib. They are high because they have little effect on the decompression time."""
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


MAX_RATIO = 1024
"""Maximum compression ratio of a member, far above that of real points. Without a limit, a small file whose members are
all zeros would take gigabytes of memory."""
SMALL_BYTES = 1 << 24
"""The compression ratio is not limited by MAX_RATIO if the content has at most this number of bytes."""


class StreamError(ValueError):
    """Raised for a damaged member. The message has the form "expected ..., got ..."."""


def compress(content: bytes, compression: Compression = "zstd") -> bytes:
    """Compress a member's content. Equal contents give equal bytes."""
    if compression == "zlib":
        return zlib.compress(content, ZLIB_LEVEL)
    return zstandard.ZstdCompressor(level=LEVEL, write_content_size=True).compress(content)


def is_zlib(member: bytes) -> bool:
    """Return True if a member is compressed with zlib, and not with Zstandard."""
    return not member.startswith(_ZSTD_MAGIC)


def stored(content: bytes) -> bytes:
    """Compress a member's content fast, with little reduction in size, for checks that encode and decode members in
    memory."""
    return zstandard.ZstdCompressor(level=-5, write_content_size=True).compress(content)


def decompress(member: bytes, largest: int) -> NDArray[np.uint8]:
    """Return the content of a member as bytes (N,).

    At most ``largest`` bytes are decompressed. A Zstandard member declares its size, which is checked before memory is
    allocated.

    Raises:
        StreamError: if the member is damaged, declares no size or has more than ``largest`` bytes.
    """
    largest = min(largest, max(SMALL_BYTES, MAX_RATIO * len(member)))
    content = _from_zlib(member, largest) if is_zlib(member) else _from_zstd(member, largest)
    return np.frombuffer(content, np.uint8)


def _from_zstd(member: bytes, largest: int) -> bytes:
    try:
        size = zstandard.frame_content_size(member)
        if not 0 <= size <= largest:
            raise StreamError(f"expected at most {largest} bytes, got {'an unknown size' if size < 0 else size}")
        content = zstandard.ZstdDecompressor().decompress(member, max_output_size=max(size, 1))
    except zstandard.ZstdError as error:
        raise StreamError(f"expected Zstandard data, got other content ({error})") from error
    if len(content) != size:
        raise StreamError(f"expected {size} bytes, got {len(content)}")
    return content


def _from_zlib(member: bytes, largest: int) -> bytes:
    stream = zlib.decompressobj()
    try:
        content = stream.decompress(member, largest + 1)
    except zlib.error as error:
        raise StreamError(f"expected Zstandard or zlib data, got other content ({error})") from error
    if len(content) > largest:
        raise StreamError(f"expected at most {largest} bytes, got more")
    if not stream.eof:
        raise StreamError(f"expected the complete zlib stream, got its first {len(content)} bytes")
    return content


def decompress_exactly(member: bytes, size: int) -> NDArray[np.uint8]:
    """Return the content of a member, which must have ``size`` bytes. Raises StreamError."""
    content = decompress(member, size)
    if len(content) != size:
        raise StreamError(f"expected {size} bytes, got {len(content)}")
    return content


def split_planes(values: NDArray[np.unsignedinteger], planes: int) -> bytes:
    """Return the bytes of values that have ``planes`` bytes each: first the lowest byte of every value, then the next
    byte of every value, and so on."""
    return b"".join((values >> np.array(8 * plane, values.dtype)).astype(np.uint8).tobytes() for plane in range(planes))


def join_planes(
    content: NDArray[np.uint8], planes: int, dtype: type[np.unsignedinteger]
) -> NDArray[np.unsignedinteger]:
    """Return the values from which :func:`split_planes` made ``content``, which contains ``planes`` bytes for each
    value."""
    rows = content.reshape(planes, -1)
    values = rows[0].astype(dtype)
    for plane in range(1, planes):
        values |= rows[plane].astype(dtype) << np.array(8 * plane, dtype)
    return values


def zigzag(values: NDArray[np.int16]) -> NDArray[np.uint16]:
    """Map the integers 0, -1, 1, -2, 2, ... to 0, 1, 2, 3, 4, ..., so that the high byte of small values is 0."""
    return ((values << 1) ^ (values >> 15)).view(np.uint16)
