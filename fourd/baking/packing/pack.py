"""Packing: convert a scene to version 3 of the `.4dv`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.baking.container import SceneReader
from fourd.baking.packing.bounds import check_bounds
from fourd.baking.packing.encoding import CloudEncoding, SceneEncoding, Tier
from fourd.baking.packing.fit import PRECISIONS, fit_encoding, sample_cloud
from fourd.baking.packing.light import LIGHT_SH_BASE, LIGHT_SH_RANGE, LightFit
from fourd.baking.packing.members import encode_cloud, morton_sorted, optional_member
from fourd.baking.packing.writer import PackedWriter
from fourd.baking.scene import BakedFrame, SceneManifest, make_frame
from fourd.progress import Track, untracked


@dataclass(frozen=True)
class PackReport:
    """Sizes of a packed scene.

    Attributes:
        bytes: size of the file.
        parts: mean compressed bytes per frame of each kind of member, such as "points" or "views". "background" is the
            size of the background, which is stored once.
        streamed: mean compressed bytes per frame that a player fetches for one viewer: all members, but only
            ``neighbours`` source views.
    """

    bytes: int
    parts: dict[str, float]
    streamed: float


def pack_scene(source: Path, out: Path, tier: Tier, track: Track = untracked) -> PackReport:
    """Write the scene ``source`` as a packed scene of a tier. Frames are read twice, one at a time.

    Args:
        source: a `.4dv` of any version.
        out: path of the packed scene. ``out`` may be the same path as ``source``.
        tier: see :data:`fourd.baking.packing.encoding.Tier`.
        track: reports progress.

    Raises:
        UserError: if ``source`` is not a valid scene, or if ``out`` cannot be written.
    """
    reader = SceneReader(source)
    try:
        return _pack(reader, out, tier, track)
    finally:
        reader.close()


def _pack(reader: SceneReader, out: Path, tier: Tier, track: Track) -> PackReport:
    manifest = reader.manifest
    convert, described = _conversion(manifest, tier)
    frames = range(manifest.frame_count)
    sampled = (sample_cloud(convert(reader.read_dynamic(index))) for index in frames)
    dynamic = reduce(lambda one, other: one.merged(other), track(sampled, len(frames), "sample"))
    background = reader.read_background()
    background = None if background is None else convert(background)
    precision = PRECISIONS[tier]
    encoding = SceneEncoding(
        tier,
        fit_encoding(dynamic, precision),
        None if background is None else fit_encoding(sample_cloud(background), precision),
    )
    described = replace(described, encoding=encoding, points=manifest.points, background=manifest.background)
    with PackedWriter(out, described) as writer:
        order: NDArray[np.int64] | None = None
        if background is not None and encoding.background is not None:
            order = morton_sorted(background, encoding.background)
            writer.add_background(_members(background, encoding.background, order))
        for index in track(frames, len(frames), "pack"):
            frame = convert(reader.read_dynamic(index))
            shadow = reader.read_shadow(index)
            shadow_bytes = None if shadow is None or order is None else shadow[order].tobytes()
            members = _members(frame, encoding.dynamic, morton_sorted(frame, encoding.dynamic))
            writer.add_frame(index, members, shadow_bytes)
    return _report(out, writer.sizes, described)


def _conversion(manifest: SceneManifest, tier: Tier) -> tuple[Callable[[BakedFrame], BakedFrame], SceneManifest]:
    """Return the function that prepares a cloud for the tier, and the manifest of the result."""
    if tier != "light" or manifest.view_count == 0:
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


def _members(cloud: BakedFrame, encoding: CloudEncoding, order: NDArray[np.int64]) -> dict[str, bytes]:
    """Encode a cloud in the given order, and check the errors of the result."""
    ordered = make_frame({name: array[order] for name, array in cloud.arrays.items()})
    members = encode_cloud(ordered, encoding)
    check_bounds(ordered, members, encoding)
    for attribute in ordered.attributes:
        if attribute.is_optional:
            members[optional_member(attribute.name)] = ordered.arrays[attribute.name].tobytes()
    return members


def _report(out: Path, sizes: dict[str, int], manifest: SceneManifest) -> PackReport:
    frames = max(manifest.frame_count, 1)
    parts: dict[str, float] = {}
    for name, size in sizes.items():
        folder, _, member = name.partition("/")
        kind = member.partition("/")[2].partition("/")[0] if folder == "frames" else folder
        parts[kind] = parts.get(kind, 0.0) + (size / frames if folder == "frames" else size)
    views = parts.get("views", 0.0)
    fetched = views * min(manifest.neighbours, manifest.view_count) / max(manifest.view_count, 1)
    per_frame = sum(size for kind, size in parts.items() if kind != "background")
    return PackReport(out.stat().st_size, parts, per_frame - views + fetched)
