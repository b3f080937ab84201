"""Packing: conversion of a scene to version 3 of the `.4dv` format."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.progress import Track, untracked
from fourd.scene.files.encoding import CloudEncoding, SceneEncoding, Tier
from fourd.scene.packed.members import encode_cloud, morton_sorted, optional_member
from fourd.scene.packed.names import frame_folder
from fourd.scene.packed.streams import Compression, compress
from fourd.scene.packing.bounds import ColourErrors, check_bounds
from fourd.scene.packing.fit import fit_encoding, merge_samples, sample_cloud
from fourd.scene.packing.images import add_images, choose_scale
from fourd.scene.packing.light import LIGHT_SH_BASE, LIGHT_SH_RANGE, LightFit
from fourd.scene.packing.precision import DEFAULT_LEVELS, LEVELS
from fourd.scene.packing.visible import find_visible
from fourd.scene.packing.writer import PackedWriter, Storage
from fourd.scene.scene import BakedFrame, SceneManifest, make_frame
from fourd.scene.splats.reader import Reader, open_reader
from fourd.scene.styled.normals import add_normals


@dataclass(frozen=True)
class PackReport:
    """Sizes of a packed scene.

    Attributes:
        bytes: size of the file.
        parts: for each kind of member, such as "points" or "views", the mean compressed size per frame in bytes. For
            "background", the total size, because the background is stored once.
        streamed: mean compressed size, in bytes per frame, of the members that a player fetches for one viewing camera:
            the members of N source views, and all members that do not belong to a source view. N is the value of
            ``manifest.neighbours``, or the number of source views if this number is smaller. The background is not
            included, because it is fetched once.
        colour_psnr: PSNR, in dB, of the packed colours of the points in the source views against the original colours.
            None if the tier does not store these colours as images.
    """

    bytes: int
    parts: dict[str, float]
    streamed: float
    colour_psnr: float | None = None


def pack_scene(
    source: Path,
    out: Path,
    tier: Tier,
    track: Track = untracked,
    *,
    level: int | None = None,
    storage: Storage | None = None,
    has_normals: bool = False,
) -> PackReport:
    """Write the scene ``source`` as a packed scene, which has quantised and compressed points, with the quality
    ``tier``. Each frame is read at least twice, and only one frame is kept in memory.

    Args:
        source: a `.4dv` of any version, a `.4dgs` file, or splats or points (a file or a folder with a file for each
            frame).
        out: path of the packed scene. ``out`` may be the same path as ``source``.
        tier: see :data:`fourd.scene.files.encoding.Tier`.
        track: reports progress.
        level: index of the tier's level in :data:`fourd.scene.packing.precision.LEVELS`. 0 is the finest. None selects
            the level of :data:`fourd.scene.packing.precision.DEFAULT_LEVELS`.
        storage: compression and order of the members.
        has_normals: whether the packed scene has normals. Web pages need normals to draw the scene in a style
            (:mod:`fourd.scene.styles`). If ``source`` has no normals, they are estimated.

    Raises:
        UserError: if ``source`` is not a valid scene or has no frames, or if ``out`` cannot be written.
    """
    reader = open_reader(source)
    try:
        chosen = DEFAULT_LEVELS[tier] if level is None else level
        frames = range(reader.manifest.frame_count)
        packer = _Packer(reader, tier, chosen, frames, track, has_normals=has_normals)
        return packer.write(out, track, storage)
    finally:
        reader.close()


def measure_frames(
    reader: Reader, frames: Sequence[int], tier: Tier, level: int, compression: Compression = "zstd"
) -> float:
    """Measure the mean number of bytes per frame that a player fetches for one viewer.

    The mean is taken over the frames with the indices ``frames``. The background is not included, because it is fetched
    once.
    """
    packer = _Packer(reader, tier, level, frames, untracked, has_background=False)
    sizes = {
        f"{frame_folder(index)}/{name}": len(compress(content, compression))
        for index in frames
        for name, content in packer.frame(index).members.items()
    }
    return _report(0, sizes, len(frames), packer.manifest).streamed


@dataclass(frozen=True)
class _Cloud:
    """An encoded cloud of points, with its members before compression."""

    points: int
    members: dict[str, bytes]


class _Packer:
    """Packs the frames and the background of a scene. All frames have the same encoding (quantisation parameters),
    which is fitted to points sampled from the given frames."""

    def __init__(
        self,
        reader: Reader,
        tier: Tier,
        level: int,
        frames: Sequence[int],
        track: Track,
        *,
        has_background: bool = True,
        has_normals: bool = False,
    ) -> None:
        if not frames:
            raise UserError(f"{reader.path}: expected a scene with at least one frame, got none; export the run again")
        self.reader = reader
        self.precision = LEVELS[tier][level]
        self.has_normals = has_normals
        self.convert, manifest = _conversion(reader.manifest, tier)
        if has_normals:
            manifest = replace(manifest, optional_attributes=(*manifest.optional_attributes, "normals"))
        self.colours = ColourErrors()
        sampled = (sample_cloud(self._read(index), len(frames)) for index in frames)
        dynamic = merge_samples(track(sampled, len(frames), "sample"))
        # All background points are kept, even those that no view of the capture shows, because a viewer may look there.
        background = reader.read_background() if has_background else None
        self.background = None if background is None else self._prepare(background, is_background=True)
        first = next((index for index in frames if reader.manifest.points[index]), frames[0])
        scale = choose_scale(self._read(first), manifest, self.precision)
        behind = None
        if self.background is not None:
            background_scale = choose_scale(self.background, manifest, self.precision)
            behind = fit_encoding(sample_cloud(self.background), self.precision, background_scale)
        self.encoding = SceneEncoding(tier, fit_encoding(dynamic, self.precision, scale), behind)
        self.manifest = replace(manifest, encoding=self.encoding)

    def frame(self, index: int) -> _Cloud:
        """Encode the points of a frame, without its shadow."""
        cloud = self._read(index, for_file=True)
        return self._encode(cloud, self.encoding.dynamic, morton_sorted(cloud, self.encoding.dynamic))

    def write(self, out: Path, track: Track, storage: Storage | None) -> PackReport:
        """Write all frames and the background."""
        frames = range(self.manifest.frame_count)
        with PackedWriter(out, self.manifest, storage, self.reader.read_sound()) as writer:
            order: NDArray[np.int64] | None = None
            if self.background is not None and self.encoding.background is not None:
                order = morton_sorted(self.background, self.encoding.background)
                writer.add_background(self._encode(self.background, self.encoding.background, order).members)
            for index in track(frames, len(frames), "pack"):
                shadow = self.reader.read_shadow(index)
                shadow_bytes = None if shadow is None or order is None else shadow[order].tobytes()
                encoded = self.frame(index)
                writer.add_frame(index, encoded.points, encoded.members, shadow_bytes)
        report = _report(out.stat().st_size, writer.sizes, len(frames), self.manifest)
        has_images = self.encoding.dynamic.image_scale is not None
        return replace(report, colour_psnr=self.colours.psnr if has_images else None)

    def _read(self, index: int, *, for_file: bool = False) -> BakedFrame:
        """Read those dynamic points of a frame that are visible in at least one view, and apply the conversion of
        :func:`_conversion` to them. Normals are left out if ``for_file`` is false.
        """
        cloud = self.reader.read_dynamic(index)
        visible = _select(cloud, find_visible(cloud, self.reader.manifest, self.precision.min_visibility))
        return self._prepare(visible) if for_file else self.convert(replace(visible, normals=None))

    def _prepare(self, cloud: BakedFrame, *, is_background: bool = False) -> BakedFrame:
        """Apply the conversion of :func:`_conversion` to a cloud. The result has normals if the packed scene has them.

        Normals are estimated before the conversion, because they are oriented towards the source views that see a
        surface, and the conversion for the tier "light" removes the source views.
        """
        if not self.has_normals:
            return self.convert(replace(cloud, normals=None))
        if cloud.normals is None:
            cloud = add_normals(cloud, self.reader.manifest, is_background=is_background)
        return self.convert(cloud)

    def _encode(self, cloud: BakedFrame, encoding: CloudEncoding, order: NDArray[np.int64]) -> _Cloud:
        """Encode a cloud in the given order, and check the errors of the result."""
        ordered = _select(cloud, order)
        rounding = self.precision.colour_rounding
        members = encode_cloud(ordered, encoding, rounding)
        cameras = self.manifest.source_cameras
        add_images(members, ordered, cameras, encoding, self.precision)
        self.colours += check_bounds(ordered, members, encoding, rounding, cameras)
        for attribute in ordered.attributes:
            if attribute.is_optional:
                members[optional_member(attribute.name)] = ordered.arrays[attribute.name].tobytes()
        return _Cloud(ordered.point_count, members)


def _select(cloud: BakedFrame, indices: NDArray[np.int64]) -> BakedFrame:
    return make_frame({name: array[indices] for name, array in cloud.arrays.items()})


def _conversion(manifest: SceneManifest, tier: Tier) -> tuple[Callable[[BakedFrame], BakedFrame], SceneManifest]:
    """Return the function that converts a cloud for the tier (quality of a packed scene), and the manifest of the
    packed scene, in which normals are not listed as an attribute. For the tier "light", the function replaces the
    source views by spherical harmonics that are fitted to the colours. So it does for scenes that are made from splats
    in every tier: the steps of the quantisation suit the range of fitted spherical harmonics, and would destroy the
    colours of splats, whose spherical harmonics have a range that is 16 times as large. Other scenes do not change."""
    optional = tuple(name for name in manifest.optional_attributes if name != "normals")
    manifest = replace(manifest, optional_attributes=optional)
    needs_fit = tier == "light" if manifest.view_count else manifest.sh_range > LIGHT_SH_RANGE
    if not needs_fit:
        return lambda cloud: cloud, manifest
    fit = LightFit(manifest)
    described = replace(
        manifest,
        source_names=(),
        source_cameras=(),
        other_names=manifest.names,
        other_cameras=manifest.cameras,
        sh_base=LIGHT_SH_BASE,
        sh_range=LIGHT_SH_RANGE,
    )
    return fit.convert, described


def _report(file_bytes: int, sizes: dict[str, int], frames: int, manifest: SceneManifest) -> PackReport:
    frames = max(frames, 1)
    parts: dict[str, float] = {}
    for name, size in sizes.items():
        folder, _, member = name.partition("/")
        kind = member.partition("/")[2].partition("/")[0] if folder == "frames" else folder
        parts[kind] = parts.get(kind, 0.0) + (size / frames if folder == "frames" else size)
    views = parts.get("views", 0.0)
    fetched = views * min(manifest.neighbours, manifest.view_count) / max(manifest.view_count, 1)
    per_frame = sum(size for kind, size in parts.items() if kind != "background")
    return PackReport(file_bytes, parts, per_frame - views + fetched)
