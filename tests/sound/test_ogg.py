"""Checks of Ogg files with Opus before they are decoded."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from fourd.recording.soundtrack.ogg import OggError, inspect_opus
from fourd.recording.soundtrack.opus import cut, decode_opus, encode_opus
from tests.sound.claps import RATE, clap, onsets


@pytest.mark.parametrize("channels", [1, 2])
@pytest.mark.parametrize("count", [1, 959, 960, 48_000, 131_072])
def test_sound_keeps_its_length(channels: int, count: int) -> None:
    """Catches an end that is cut off, or silence of the encoder before or after the sound."""
    content = encode_opus([np.full((channels, count), 0.1, np.float32)], channels)
    info = inspect_opus(content)
    assert (info.channels, info.samples) == (channels, count)
    assert sum(block.shape[1] for block in decode_opus(content)) == count


def test_sound_keeps_its_time() -> None:
    """Catches the delay of the encoder, which moves all sounds."""
    decoded = np.concatenate(list(decode_opus(encode_opus([clap(2, 0.5, 1.25)], 1))), axis=1)
    assert onsets(decoded) == pytest.approx([0.5, 1.25], abs=1e-3)


@pytest.mark.parametrize(("begin", "expected"), [(-RATE, [1.5]), (0, [0.5]), (RATE // 4, [0.25]), (RATE, [])])
def test_cut(begin: int, expected: list[float]) -> None:
    """Catches a part of a sound that is off by its beginning, and a part that is too short."""
    blocks = [clap(1, 0.5)[:, :30_000], clap(1, 0.5)[:, 30_000:]]
    part = np.concatenate(list(cut(blocks, begin, 2 * RATE, 1)), axis=1)
    assert part.shape == (1, 2 * RATE)
    assert onsets(part) == pytest.approx(expected, abs=1e-6)


def without_crc(content: bytes, position: int, replaced: bytes) -> bytes:
    return content[:position] + replaced + content[position + len(replaced) :]


def bomb(seconds: float) -> bytes:
    """A file whose packets of two bytes decode to a long silence."""
    pages = encode_opus([clap(0.1, 0.05)], 1)
    head = pages[: pages.index(b"OggS", pages.index(b"OpusTags"))]
    serial = head[14:18]
    made, granule = [head], 0
    count = round(seconds / 0.12)
    for start in range(0, count, 255):
        packets = min(255, count - start)
        granule += packets * 5760
        last = 4 if start + packets == count else 0
        number = 2 + start // 255
        page = struct.pack("<4sBBq4sIIB", b"OggS", 0, last, granule, serial, number, 0, packets)
        # Configuration 31, 20 ms, code 3 with 6 frames: 120 ms in two bytes.
        made.append(page + bytes([2] * packets) + bytes([0xFB, 6]) * packets)
    return b"".join(made)


def test_a_bomb_is_measured_without_decoding_it() -> None:
    """Catches a duration that is read from the end of the file instead of its packets: here, 4 kB last 4 minutes."""
    content = bomb(240)
    assert len(content) < 8_000
    assert inspect_opus(content).seconds == pytest.approx(240, abs=0.1)
    # The same packets in a file that claims to be short.
    at = content.rindex(b"OggS") + 6
    with pytest.raises(OggError, match="expected sound of"):
        inspect_opus(without_crc(content, at, struct.pack("<q", 48_000)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda content: b"", "another codec"),
        (lambda content: b"RIFF" + content[4:], "another structure"),
        (lambda content: content[:100], "a part of one"),
        (lambda content: content[: content.rindex(b"OggS")], "without its end"),
        (lambda content: content + content, "another structure"),
        (lambda content: content.replace(b"OpusHead", b"vorbis!!"), "another codec"),
        (lambda content: content.replace(b"OpusHead\x01\x01", b"OpusHead\x01\x06"), "6 channels"),
        (lambda content: content.replace(b"OpusTags", b"OpusTogs"), "second header"),
    ],
)
def test_other_files_are_refused(change: object, words: str) -> None:
    """Catches a damaged or foreign file that reaches the decoder."""
    content = encode_opus([clap(1, 0.5)], 1)
    assert callable(change)
    with pytest.raises(OggError, match=words):
        inspect_opus(change(content))


def test_random_damage_never_crashes(rng: np.random.Generator) -> None:
    """Catches an exception other than OggError for damaged bytes, and sound that is longer than its headers say."""
    content = bytearray(encode_opus([clap(0.5, 0.2)], 1))
    for _ in range(300):
        damaged = bytearray(content)
        for place in rng.integers(0, len(content), 3):
            damaged[place] = rng.integers(0, 256)
        damaged = damaged[: rng.integers(1, len(content) + 1)] if rng.random() < 0.3 else damaged
        try:
            info = inspect_opus(bytes(damaged))
            assert sum(block.shape[1] for block in decode_opus(bytes(damaged))) == info.samples
        except OggError:
            pass
