"""Checks Ogg files with one Opus stream before they are decoded. The files are untrusted: a few bytes of Opus can
decode to minutes of sound, so the duration is summed from the headers of the packets.

The structure of the files is that of RFC 3533 (Ogg), RFC 7845 (Opus in Ogg) and RFC 6716 (Opus).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

RATE = 48000
"""Sampling rate in Hz of Opus, and of all soundtracks that fourd stores."""
MAX_CHANNELS = 2
_PAGE = struct.Struct("<4sBBqIIIB")
_FIRST, _LAST = 0x02, 0x04
_HEAD = struct.Struct("<8sBBHIhB")
_FRAME_SAMPLES = (*(480, 960, 1920, 2880) * 3, *(480, 960) * 2, *(120, 240, 480, 960) * 4)
"""Samples of a frame for each of the 32 configurations of a packet (RFC 6716, table 2)."""
_MAX_PACKET = 5760


class OggError(ValueError):
    """Raised for a file that is not a complete Ogg file with one Opus stream. The message has the form "expected ...,
    got ..."."""


@dataclass(frozen=True)
class OpusInfo:
    """What the headers of an Ogg file with Opus say.

    Attributes:
        channels: 1 or 2.
        samples: number of samples of each channel after decoding, at 48 kHz.
    """

    channels: int
    samples: int

    @property
    def seconds(self) -> float:
        return self.samples / RATE


def inspect_opus(content: bytes) -> OpusInfo:
    """Check an Ogg file without decoding it. Raises OggError."""
    packets = _packets(content)
    head = next(packets, (b"", 0, False))[0]
    if len(head) < _HEAD.size or not head.startswith(b"OpusHead"):
        raise OggError("expected Opus in an Ogg file, got another codec")
    _, version, channels, skipped, _, _, family = _HEAD.unpack_from(head)
    if version >> 4 or family or not 1 <= channels <= MAX_CHANNELS:
        raise OggError(f"expected Opus of 1 or 2 channels, got {channels} channels of family {family}")
    if not next(packets, (b"", 0, False))[0].startswith(b"OpusTags"):
        raise OggError("expected Opus in an Ogg file, got a stream without its second header")
    total, end, is_complete = 0, 0, False
    for packet, granule, is_last in packets:
        total += _packet_samples(packet)
        end, is_complete = granule, is_last
    if not is_complete:
        raise OggError("expected a complete Ogg file, got one without its end")
    if not skipped < end <= total or total - end > RATE:
        raise OggError(f"expected sound of {total} samples, got one that ends after {end}")
    return OpusInfo(channels, end - skipped)


def _packets(content: bytes) -> Iterator[tuple[bytes, int, bool]]:
    """Yield the first bytes of each packet, the position of the page in which it ends, in samples, and whether this is
    the last page. Raises OggError."""
    position, number, stream, packet, is_last = 0, 0, None, bytearray(), False
    while position < len(content):
        if position + _PAGE.size > len(content):
            raise OggError("expected a complete Ogg file, got a part of one")
        mark, version, flags, granule, serial, sequence, _, count = _PAGE.unpack_from(content, position)
        if mark != b"OggS" or version or sequence != number or is_last or (flags & _FIRST > 0) != (number == 0):
            raise OggError("expected an Ogg file with one stream, got another structure")
        if stream not in (None, serial):
            raise OggError("expected an Ogg file with one stream, got several")
        stream, number, is_last = serial, number + 1, flags & _LAST > 0
        sizes = content[position + _PAGE.size : position + _PAGE.size + count]
        position += _PAGE.size + count
        if len(sizes) < count or position + sum(sizes) > len(content):
            raise OggError("expected a complete Ogg file, got a part of one")
        for size in sizes:
            # Only the first bytes of a packet are read.
            packet += content[position : position + min(size, 32)]
            position += size
            if size < 255:
                yield bytes(packet), granule, is_last
                packet.clear()


def _packet_samples(packet: bytes) -> int:
    if not packet:
        raise OggError("expected Opus packets, got an empty one")
    code = packet[0] & 3
    if code == 3 and len(packet) < 2:
        raise OggError("expected Opus packets, got a part of one")
    frames = (1, 2, 2, packet[1] & 63 if code == 3 else 0)[code]
    samples = frames * _FRAME_SAMPLES[packet[0] >> 3]
    if not 0 < samples <= _MAX_PACKET:
        raise OggError(f"expected Opus packets of at most 120 ms, got one of {samples / 48:g} ms")
    return samples
