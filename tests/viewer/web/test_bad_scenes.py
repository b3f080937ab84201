"""Damaged scenes end with a message in the page."""

from __future__ import annotations

import json
import shutil
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from fourd.scene.packing.pack import pack_scene
from fourd.viewer.publish.site import SCENE_NAME
from tests.baking.scenes import write_scene
from tests.viewer.web.conftest import serving
from tests.viewer.web.page import PlayerPage

Show = Callable[[bytes], str]


@pytest.fixture
def content(object_site: Path) -> bytes:
    """The bytes of an intact scene."""
    return (object_site / SCENE_NAME).read_bytes()


@pytest.fixture
def show(open_page: Callable[..., PlayerPage], object_site: Path, tmp_path: Path) -> Iterator[Show]:
    """A function that opens a page with a scene of the given bytes, and returns the error that the page shows."""
    site = tmp_path / "site"
    shutil.copytree(object_site, site)
    with serving(site) as server:

        def open_one(scene: bytes) -> str:
            (site / SCENE_NAME).write_bytes(scene)
            page = open_page(server.url)
            message = page.error()
            assert page.run("return player.panel.bar.hidden;"), "controls without a scene"
            assert "\n" not in message
            return message

        yield open_one


def with_manifest(content: bytes, change: Callable[[dict[str, Any]], object]) -> bytes:
    """Return the scene with a changed manifest of the same size."""
    name, extra = struct.unpack_from("<2H", content, 26)
    (size,) = struct.unpack_from("<L", content, 22)
    start = 30 + name + extra
    manifest = json.loads(content[start : start + size])
    change(manifest)
    text = json.dumps(manifest, separators=(",", ":")).encode().ljust(size)
    assert len(text) == size
    return content[:start] + text + content[start + size :]


def test_a_truncated_scene(content: bytes, show: Show) -> None:
    """Catches a page that waits for bytes past the end of the file."""
    assert "copy the file again" in show(content[: len(content) // 8])


def test_other_files(show: Show) -> None:
    """Catches a page that reads files of other formats as scenes."""
    assert "got another kind of file" in show(b"<html></html>" * 100)
    assert "got another kind of file" in show(b"")


def test_an_unpacked_scene(show: Show, tmp_path: Path) -> None:
    """Catches an unclear message for a file that the page cannot read."""
    write_scene(tmp_path / "plain.4dv")
    assert show((tmp_path / "plain.4dv").read_bytes()).endswith("use fourd web")


def test_a_scene_in_zstandard(show: Show, tmp_path: Path) -> None:
    """Catches an unclear message for a compression that browsers do not support."""
    write_scene(tmp_path / "plain.4dv")
    pack_scene(tmp_path / "plain.4dv", tmp_path / "packed.4dv", "full")
    assert show((tmp_path / "packed.4dv").read_bytes()).endswith("which browsers cannot decompress; use fourd web")


def test_a_damaged_member(content: bytes, show: Show) -> None:
    """Catches damaged bytes that are drawn as points."""
    manifest = json.loads(content[43 : 43 + struct.unpack_from("<L", content, 22)[0]])
    offset, size = manifest["members"]["frames/000000/points"]
    changed = bytearray(content)
    changed[offset + size // 2] ^= 0xFF
    assert show(bytes(changed)).startswith("frames/000000/points: expected ")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda m: m.update(version=6), "The scene has format version 6, but this player reads version 5"),
        (lambda m: m["frames"][0].update(points=3999), "frames/000000/"),
        (lambda m: m["frames"][0].update(points=10**9), "frames[0], points: expected a number from 0 to"),
        (lambda m: m["encoding"]["dynamic"].update(sh_rows=1), "sh_basis: expected 48 finite numbers"),
        (lambda m: m["frames"][0].update(points=2**24), "which cannot contain them"),
        (lambda m: m["encoding"]["dynamic"].update(radius_steps=1), "points: expected radii below"),
        (lambda m: m["members"].update({"\n": [0, -1]}), 'members, "\\n": expected an offset and a size'),
        (lambda m: m["encoding"]["dynamic"].update(weight_steps=0), "weight_steps: expected a number from 1"),
        (lambda m: m["members"].pop("frames/000000/sh"), "expected the member frames/000000/sh, got none"),
        (lambda m: m["members"].update({"frames/000000/sh": [2**40, 9]}), "copy the file again"),
        (lambda m: m["members"].update({"frames/000000/sh": m["members"]["frames/000000/points"]}), "frames/000000/sh"),
        (lambda m: m.update(frames=[]), "The scene has no frames"),
        (lambda m: m.update(near="x"), "near: expected a number"),
    ],
)
def test_inconsistent_manifests(
    change: Callable[[dict[str, Any]], object], expected: str, content: bytes, show: Show
) -> None:
    """Catches counts and sizes in the manifest that the page uses without a check."""
    assert expected in show(with_manifest(content, change))
