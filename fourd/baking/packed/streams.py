"""Members of a packed scene: byte planes under Zstandard (RFC 8878)."""

from __future__ import annotations

import numpy as np
import zstandard
from numpy.typing import NDArray

LEVEL = 19
"""Compression level. The level hardly changes the time of decompression."""


class StreamError(ValueError):
    """A damaged member. The message has the form "expected ..., got ..."."""


def compress(content: bytes) -> bytes:
    """Compress a member's content. Equal contents give equal bytes."""
    return zstandard.ZstdCompressor(level=LEVEL, write_content_size=True).compress(content)


def stored(content: bytes) -> bytes:
    """Compress a member's content fast, without making it much smaller. For checks in memory."""
    return zstandard.ZstdCompressor(level=-5, write_content_size=True).compress(content)


def decompress(member: bytes, largest: int) -> NDArray[np.uint8]:
    """Return the content of a member as bytes (N,).

    The size that the member declares is compared with ``largest``, in bytes, before memory is allocated.

    Raises:
        StreamError: if the member is damaged, declares no size or declares more than ``largest``.
    """
    try:
        size = zstandard.frame_content_size(member)
        if not 0 <= size <= largest:
            raise StreamError(f"expected at most {largest} bytes, got {'an unknown size' if size < 0 else size}")
        content = zstandard.ZstdDecompressor().decompress(member, max_output_size=max(size, 1))
    except zstandard.ZstdError as error:
        raise StreamError(f"expected Zstandard data, got other content ({error})") from error
    if len(content) != size:
        raise StreamError(f"expected {size} bytes, got {len(content)}")
    return np.frombuffer(content, np.uint8)


def decompress_exactly(member: bytes, size: int) -> NDArray[np.uint8]:
    """Return the content of a member, which must have ``size`` bytes. Raises StreamError."""
    content = decompress(member, size)
    if len(content) != size:
        raise StreamError(f"expected {size} bytes, got {len(content)}")
    return content


def split_planes(values: NDArray[np.unsignedinteger], planes: int) -> bytes:
    """Return the lowest byte of all values, then the next byte of all values, and so on, for ``planes`` bytes."""
    return b"".join((values >> np.array(8 * plane, values.dtype)).astype(np.uint8).tobytes() for plane in range(planes))


def join_planes(
    content: NDArray[np.uint8], planes: int, dtype: type[np.unsignedinteger]
) -> NDArray[np.unsignedinteger]:
    """Return the values of :func:`split_planes`. ``content`` has ``planes`` times as many bytes as values."""
    rows = content.reshape(planes, -1)
    values = rows[0].astype(dtype)
    for plane in range(1, planes):
        values |= rows[plane].astype(dtype) << np.array(8 * plane, dtype)
    return values


def zigzag(values: NDArray[np.int16]) -> NDArray[np.uint16]:
    """Map 0, -1, 1, -2, 2, ... to 0, 1, 2, 3, 4, ..., so that small values have a high byte of 0."""
    return ((values << 1) ^ (values >> 15)).view(np.uint16)
