"""Random scene files for tests of readers. The files have damaged bytes, manifests with invalid values, or damaged
members.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from typing import Any

import numpy as np
import zstandard

from tests.baking.damage import damage

POISON: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    1,
    7,
    255,
    2**26,
    2**26 + 1,
    2**31,
    2**63,
    10**30,
    -0.0,
    1e-40,
    1e300,
    float("nan"),
    float("inf"),
    "",
    "full",
    "light",
    "../x",
    "a\nb",
    [],
    {},
    [[]],
    [0] * 50,
)
"""Invalid or extreme values that are put into a manifest."""
_LARGEST_BOMB = 1 << 22


class SceneMutator:
    """Makes damaged copies of a scene. Most copies are valid ZIP archives, so that the decoders read the damaged
    content."""

    def __init__(self, content: bytes, rng: np.random.Generator) -> None:
        self._content = content
        self._rng = rng
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            self._members = {name: archive.read(name) for name in archive.namelist()}

    def next(self) -> bytes:
        """Return the next damaged copy."""
        kind = self._rng.integers(10)
        if kind == 0:
            return damage(self._content, self._rng, 20)
        members = dict(self._members)
        for _ in range(int(self._rng.integers(1, 4))):
            if kind < 5:
                members["manifest.json"] = self._poison(members["manifest.json"])
            else:
                self._change_member(members)
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as archive:
            for name, content in members.items():
                archive.writestr(name, content)
        return out.getvalue()

    def _poison(self, manifest: bytes) -> bytes:
        """Replace or remove a random value at a random nesting depth."""
        root = json.loads(manifest)
        node = root
        while True:
            keys = list(node) if isinstance(node, dict) else list(range(len(node)))
            if not keys:
                break
            key = keys[self._rng.integers(len(keys))]
            if isinstance(node[key], dict | list) and self._rng.random() < 0.8:
                node = node[key]
            elif self._rng.random() < 0.15:
                del node[key]
                break
            else:
                node[key] = POISON[self._rng.integers(len(POISON))]
                break
        return json.dumps(root).encode()

    def _change_member(self, members: dict[str, bytes]) -> None:
        names = [name for name in members if name != "manifest.json"]
        if not names:
            return
        name = names[self._rng.integers(len(names))]
        choice = self._rng.integers(8)
        if choice == 0:
            del members[name]
        elif choice == 1:
            members[name] = members[names[self._rng.integers(len(names))]]
        elif choice == 2:
            members[name] = damage(members[name] or b"x", self._rng, 8)
        elif choice == 3:
            members[name] = self._compress(bytes(int(self._rng.integers(_LARGEST_BOMB))))
        else:
            members[name] = self._damage_inside(members[name])

    def _damage_inside(self, member: bytes) -> bytes:
        """Damage the content of a compressed member, and compress the result."""
        try:
            content = zstandard.ZstdDecompressor().decompress(member)
        except zstandard.ZstdError:
            return damage(member or b"x", self._rng, 40)
        return self._compress(damage(content or b"x", self._rng, 40))

    def _compress(self, content: bytes) -> bytes:
        if self._rng.random() < 0.3:
            return zlib.compress(content)
        has_size = bool(self._rng.random() < 0.9)
        return zstandard.ZstdCompressor(level=1, write_content_size=has_size).compress(content)
