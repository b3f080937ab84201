"""Copies packed scenes and compresses their members with another method, without quantising the points again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.progress import Track, untracked
from fourd.scene.container import SceneReader
from fourd.scene.files.encoding import SH_NUMBERS, CloudEncoding
from fourd.scene.files.sound import OpusSound
from fourd.scene.packed.images import largest_image
from fourd.scene.packed.members import optional_member, packed_names
from fourd.scene.packed.names import BACKGROUND, frame_folder
from fourd.scene.packed.streams import decompress
from fourd.scene.packing.writer import PackedWriter, Storage
from fourd.scene.scene import BakedFrame, SceneManifest
from fourd.scene.styled.normals import add_normals


def transcode_scene(
    source: Path, out: Path, storage: Storage, track: Track = untracked, *, has_normals: bool = False
) -> None:
    """Write the packed scene ``source`` as ``out``, with another compression and another order of the members. If
    ``has_normals`` is True and ``source`` has no normals, they are estimated. Every frame of ``source`` is decoded, so
    that damaged members are found.

    Raises:
        UserError: if ``source`` is damaged or is not a packed scene, or if ``out`` cannot be written.
    """
    reader = SceneReader(source)
    try:
        manifest = reader.manifest
        if manifest.encoding is None:
            raise UserError(f"{source}: expected a packed scene, got version {manifest.version}; use fourd pack first")
        adds_normals = has_normals and "normals" not in manifest.optional_attributes
        written = replace(manifest, optional_attributes=(*manifest.optional_attributes, "normals"))
        with PackedWriter(out, written if adds_normals else manifest, storage, reader.read_sound()) as writer:
            background = reader.read_background()
            if background is not None and manifest.encoding.background is not None:
                points = background.point_count
                contents = _contents(reader, BACKGROUND, points, manifest.encoding.background)
                contents |= _normals(background, manifest, is_background=True) if adds_normals else {}
                writer.add_background(contents)
            for index in track(range(manifest.frame_count), manifest.frame_count, "compress"):
                frame = reader.read_dynamic(index)
                points = manifest.points[index]
                contents = _contents(reader, frame_folder(index), points, manifest.encoding.dynamic)
                contents |= _normals(frame, manifest) if adds_normals else {}
                shadow = reader.read_shadow(index)
                writer.add_frame(index, points, contents, None if shadow is None else shadow.tobytes())
    finally:
        reader.close()


def copy_frames(
    reader: SceneReader,
    out: Path,
    chosen: Sequence[int],
    manifest: SceneManifest,
    sound: OpusSound | None = None,
    track: Track = untracked,
) -> None:
    """Write the frames of a packed scene with the indices ``chosen`` as ``out``, without quantising the points again.

    Args:
        reader: the packed scene.
        manifest: the manifest of the result, with ``encoding``. Its kind may be "object" although the scene has a
            background, which is then left out.
        sound: the sound of the chosen frames, or None.
        track: reports progress.

    Raises:
        UserError: if the scene is damaged, or if ``out`` cannot be written.
    """
    has_background = manifest.kind == "full"
    with PackedWriter(out, manifest, None, sound) as writer:
        background = reader.read_background() if has_background else None
        assert manifest.encoding is not None
        if background is not None and manifest.encoding.background is not None:
            points = background.point_count
            writer.add_background(_contents(reader, BACKGROUND, points, manifest.encoding.background))
        for index in track(range(len(chosen)), len(chosen), "copy"):
            frame = chosen[index]
            points = reader.read_dynamic(frame).point_count
            contents = _contents(reader, frame_folder(frame), points, manifest.encoding.dynamic)
            shadow = reader.read_shadow(frame) if has_background else None
            writer.add_frame(index, points, contents, None if shadow is None else shadow.tobytes())


def _contents(reader: SceneReader, folder: str, points: int, encoding: CloudEncoding) -> dict[str, bytes]:
    """Return the decompressed contents of a cloud's members, which are the files below ``folder`` in the archive. The
    caller must have read the cloud with ``reader``, which checks the members."""
    manifest = reader.manifest
    optional = [item.nbytes(points, manifest.view_count) for item in manifest.attributes if item.is_optional]
    largest = max(points * max(encoding.code_bytes + 3, 2 * SH_NUMBERS), *optional, 0)
    if encoding.image_scale is not None:
        largest += max(largest_image(camera, encoding.image_scale) for camera in manifest.source_cameras)
    names = packed_names(manifest)
    return {name: decompress(reader.read_member(f"{folder}/{name}"), largest).tobytes() for name in names}


def _normals(cloud: BakedFrame, manifest: SceneManifest, *, is_background: bool = False) -> dict[str, bytes]:
    """Return the member with the estimated normals of a cloud."""
    complete = add_normals(cloud, manifest, is_background=is_background)
    return {optional_member("normals"): complete.arrays["normals"].tobytes()}
