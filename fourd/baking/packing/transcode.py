"""Copies packed scenes and compresses their members with another method. The points are not quantised again, so no
precision is lost."""

from __future__ import annotations

from pathlib import Path

from fourd.baking.container import BACKGROUND, SceneReader, frame_folder
from fourd.baking.files.encoding import SH_NUMBERS, CloudEncoding
from fourd.baking.packed.members import packed_names
from fourd.baking.packed.streams import decompress
from fourd.baking.packing.writer import PackedWriter, Storage
from fourd.errors import UserError
from fourd.progress import Track, untracked


def transcode_scene(source: Path, out: Path, storage: Storage, track: Track = untracked) -> None:
    """Write the packed scene ``source`` as ``out``, with another compression and another order of the members. The
    frames of ``source`` are checked.

    Raises:
        UserError: if ``source`` is damaged or is not a packed scene, or if ``out`` cannot be written.
    """
    reader = SceneReader(source)
    try:
        manifest = reader.manifest
        if manifest.encoding is None:
            raise UserError(f"{source}: expected a packed scene, got version {manifest.version}; use fourd pack first")
        with PackedWriter(out, manifest, storage) as writer:
            background = reader.read_background()
            if background is not None and manifest.encoding.background is not None:
                points = background.point_count
                writer.add_background(_contents(reader, BACKGROUND, points, manifest.encoding.background))
            for index in track(range(manifest.frame_count), manifest.frame_count, "compress"):
                reader.read_dynamic(index)
                points = manifest.points[index]
                contents = _contents(reader, frame_folder(index), points, manifest.encoding.dynamic)
                shadow = reader.read_shadow(index)
                writer.add_frame(index, points, contents, None if shadow is None else shadow.tobytes())
    finally:
        reader.close()


def _contents(reader: SceneReader, folder: str, points: int, encoding: CloudEncoding) -> dict[str, bytes]:
    """Return the decompressed contents of a cloud's members. The reader must have checked the members before."""
    manifest = reader.manifest
    optional = [item.nbytes(points, manifest.view_count) for item in manifest.attributes if item.is_optional]
    largest = max(points * max(encoding.code_bytes + 3, 2 * SH_NUMBERS), *optional, 0)
    names = packed_names(manifest)
    return {name: decompress(reader.read_member(f"{folder}/{name}"), largest).tobytes() for name in names}
