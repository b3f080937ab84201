"""Detection of truncated Matroska and WebM files.

Truncation is detected from the length in bytes, because the header of a Matroska file contains no frame count (RFC
8794, RFC 9559).
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from fourd.base.limits import open_regular

HEADER = b"\x1a\x45\xdf\xa3"
SEGMENT = b"\x18\x53\x80\x67"


def missing_bytes(path: Path) -> int:
    """Return the number of bytes that are missing at the end of a Matroska file.

    The result is 0 for complete files, for files in other formats, and for files whose header does not contain the file
    size, as in a live recording that was not finalised.
    """
    with open_regular(path) as stream:
        if stream.read(len(HEADER)) != HEADER:
            return 0
        header, file_size = _size(stream), path.stat().st_size
        if header is None or header > file_size:
            return 0
        stream.seek(header, 1)
        if stream.read(len(SEGMENT)) != SEGMENT:
            return 0
        segment = _size(stream)
        return 0 if segment is None else max(0, stream.tell() + segment - file_size)


def _size(stream: BinaryIO) -> int | None:
    """Read the size in bytes of a Matroska element; return None if the size is unknown.

    The number of leading zero bits in the first byte equals the number of further bytes of the size.
    """
    first = stream.read(1)
    if not first or not first[0]:
        return None
    length = 9 - first[0].bit_length()
    rest = stream.read(length - 1)
    unknown = (1 << 7 * length) - 1
    value = int.from_bytes(first + rest, "big") & unknown
    return None if value == unknown or len(rest) < length - 1 else value
