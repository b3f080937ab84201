"""Damages files of any kind at random. The damage changes bytes, numbers, text or structure, or replaces a file by
another kind of file.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

NUMBERS = (
    "nan",
    "inf",
    "-inf",
    "-1",
    "0",
    "-0.0",
    "1e308",
    "1e400",
    "1e-320",
    "2147483648",
    "9223372036854775808",
    "-9223372036854775809",
    "9" * 400,
    "9" * 5000,
    "1.5",
    "1_0",
    "0x10",
    "1/0",
    "1e99999999",
    "true",
    "null",
    '""',
    "[]",
    "{}",
    "",
)
"""Texts that replace a number."""
WORDS = (
    b"\x1b]0;hostile\x07",
    b"[/x][red]",
    b"%s%n{0}",
    b"../../outside",
    b"/dev/zero",
    b"\xff\xfe",
    b"a" * 70_000,
    b"\\u0000",
    b"\n",
    b"'\"",
    b"!!python/object/apply:os.system",
    b"\xe2\x80\xae",
)
"""Bytes that replace a word."""
NESTED = (b"[" * 5000, b"{" * 5000, b"<a>" * 5000, b"- " * 5000, b"(" * 5000, b"{a: " * 3000)
NUMBER = re.compile(rb"-?\d+\.?\d*(?:e[-+]?\d+)?", re.IGNORECASE)
WORD = re.compile(rb"[A-Za-z_]{2,}")
EXTREMES = (0, 1, -1, 2**15, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**62, 2**63 - 1, -(2**63))
MAX_DAMAGED = 6


def damage_file(path: Path, rng: np.random.Generator) -> str:
    """Damage a file in a random way. Returns a short description."""
    if rng.random() < 0.08:
        return _replace_kind(path, rng)
    content = path.read_bytes()
    is_text = b"\0" not in content[:4096] and content.isascii()
    ways = (_numbers, _words, _nest, _lines) if is_text else (_integers, _bytes, _blocks)
    way = (_bytes, _cut)[rng.integers(2)] if rng.random() < 0.2 else ways[rng.integers(len(ways))]
    for _ in range(int(rng.integers(1, MAX_DAMAGED)) if way is not _nest else 1):
        content = way(content or b"0", rng)
    path.unlink()
    path.write_bytes(content)
    return way.__name__.strip("_")


def _replace_kind(path: Path, rng: np.random.Generator) -> str:
    """Replace a file by a named pipe, a symbolic link, a folder, an empty file or a huge sparse file."""
    path.unlink()
    kind = ("pipe", "device", "loop", "missing", "folder", "empty", "hole")[rng.integers(7)]
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind in ("device", "loop", "missing"):
        path.symlink_to({"device": "/dev/zero", "loop": path.name, "missing": "absent"}[kind])
    else:
        with path.open("wb") as stream:
            stream.truncate(1 << 40 if kind == "hole" else 0)
    return kind


def _numbers(content: bytes, rng: np.random.Generator) -> bytes:
    found = list(NUMBER.finditer(content))
    if not found:
        return _words(content, rng)
    match = found[rng.integers(len(found))]
    return content[: match.start()] + NUMBERS[rng.integers(len(NUMBERS))].encode() + content[match.end() :]


def _words(content: bytes, rng: np.random.Generator) -> bytes:
    found = list(WORD.finditer(content))
    if not found:
        return _bytes(content, rng)
    match = found[rng.integers(len(found))]
    return content[: match.start()] + WORDS[rng.integers(len(WORDS))] + content[match.end() :]


def _nest(content: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(content) + 1))
    return content[:at] + NESTED[rng.integers(len(NESTED))] + content[at:]


def _lines(content: bytes, rng: np.random.Generator) -> bytes:
    """Remove, repeat or exchange lines."""
    lines = content.split(b"\n")
    first, second = rng.integers(len(lines), size=2)
    choice = rng.integers(3)
    if choice == 0:
        del lines[first]
    elif choice == 1:
        lines[second:second] = [lines[first]] * int(rng.choice([1, 2, 3000]))
    else:
        lines[first], lines[second] = lines[second], lines[first]
    return b"\n".join(lines)


def _integers(content: bytes, rng: np.random.Generator) -> bytes:
    """Replace 2, 4 or 8 bytes by an extreme integer. Most of the replaced bytes are among the first 256 bytes."""
    size = int(rng.choice([2, 4, 8]))
    most = len(content) if rng.random() < 0.4 else min(len(content), 256)
    at = int(rng.integers(most))
    value = EXTREMES[rng.integers(len(EXTREMES))] % (1 << 8 * size)
    return content[:at] + value.to_bytes(size, "little" if rng.random() < 0.7 else "big") + content[at + size :]


def _bytes(content: bytes, rng: np.random.Generator) -> bytes:
    damaged = bytearray(content)
    for at in rng.integers(len(damaged), size=int(rng.integers(1, 20))):
        damaged[at] = int(rng.integers(256))
    return bytes(damaged)


def _blocks(content: bytes, rng: np.random.Generator) -> bytes:
    """Remove a block of bytes, repeat it or set it to zeros."""
    first, last = np.sort(rng.integers(len(content) + 1, size=2))
    block = content[first:last]
    return content[:first] + (b"", block * 2, bytes(len(block)))[rng.integers(3)] + content[last:]


def _cut(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: rng.integers(len(content) + 1)]
