"""Names and sizes of the members of a `.4dv`, which are the files inside the ZIP."""

from __future__ import annotations

from collections.abc import Iterator

from fourd.scene.files.sound import SOUND_NAME
from fourd.scene.packed.members import packed_names
from fourd.scene.scene import SceneManifest

MANIFEST_NAME = "manifest.json"
BACKGROUND = "background"
"""Folder inside the ZIP that contains the arrays of the background."""
SHADOW = "shadow"


def member_name(frame: int, attribute: str) -> str:
    """Return the path of a frame's array inside the ZIP."""
    return f"{frame_folder(frame)}/{attribute}"


def frame_folder(index: int) -> str:
    """Return the folder of a frame inside the ZIP."""
    return f"frames/{index:06d}"


def member_sizes(manifest: SceneManifest) -> Iterator[tuple[str, int | None]]:
    """Yield the name and the size in bytes of each member (file inside the ZIP) of a scene. The size is None for
    compressed members."""
    packed = manifest.encoding is not None
    if manifest.sound is not None:
        yield SOUND_NAME, manifest.sound.bytes
    folders = [(frame_folder(index), points) for index, points in enumerate(manifest.points)]
    if manifest.background is not None:
        if manifest.background.shadow:
            for folder, _ in folders:
                yield f"{folder}/{SHADOW}", None if packed else manifest.background.points
        folders.append((BACKGROUND, manifest.background.points))
    for folder, points in folders:
        if packed:
            yield from ((f"{folder}/{name}", None) for name in packed_names(manifest))
        else:
            for attribute in manifest.attributes:
                yield f"{folder}/{attribute.name}", attribute.nbytes(points, manifest.view_count)
