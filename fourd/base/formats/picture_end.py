"""Detection of JPEG and PNG files whose end is missing, although their remaining content can be decoded."""

from __future__ import annotations

JPEG_START, JPEG_END = b"\xff\xd8", b"\xff\xd9"
PNG_START, PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
START_OF_SCAN = 0xDA
MARKERS_WITHOUT_LENGTH = frozenset({0x01, *range(0xD0, 0xD9)})


def has_end(content: bytes) -> bool:
    """Return whether a JPEG or PNG file contains the marker of its end.

    An interrupted copy often has the right size, but zeros instead of the last bytes. Decoders read zeros in a JPEG as
    grey pixels, and report no error. Bytes after the marker are allowed, because some cameras append their own data.
    The result is True for other formats.
    """
    if content.startswith(PNG_START):
        return PNG_END in content
    if content.startswith(JPEG_START):
        return content.find(JPEG_END, _find_scan(content)) >= 0
    return True


def _find_scan(content: bytes) -> int:
    """Return the position of the first scan of a JPEG file, or of the first bytes that are no header.

    The headers are skipped, because the preview image in a header has an end marker of its own.
    """
    position = len(JPEG_START)
    while position + 4 <= len(content) and content[position] == 0xFF:
        marker = content[position + 1]
        if marker == START_OF_SCAN:
            return position
        if marker == 0xFF:
            position += 1
        elif marker in MARKERS_WITHOUT_LENGTH:
            position += 2
        else:
            position += 2 + int.from_bytes(content[position + 2 : position + 4], "big")
    return position
