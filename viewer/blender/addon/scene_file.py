"""Reads the points of a `.4dv` file with NumPy. A colour is the mean over the source views, plus the constant part of
the spherical harmonics; the other parts depend on the viewing direction."""

from __future__ import annotations

import math
import zipfile
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.viewer.blender.addon.manifest import Encoding, Manifest
from fourd.viewer.blender.addon.points import Cloud, ImportProblem

SH_CONSTANT = 0.5 / math.sqrt(math.pi)
"""The spherical harmonic of degree 0."""
SH_TERMS = 16
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
BACKGROUND = "background"


def read_frame(manifest: Manifest, frame: int) -> Cloud:
    """Read the points of a frame, without the static background. Raises ImportProblem."""
    return _read(manifest, f"frames/{frame:06d}", manifest.points[frame], manifest.dynamic)


def read_background(manifest: Manifest) -> Cloud:
    """Read the static points of a full scene, without the shadows of the subject. Raises ImportProblem."""
    return _read(manifest, BACKGROUND, manifest.background_points, manifest.background)


def _read(manifest: Manifest, folder: str, points: int, encoding: Encoding | None) -> Cloud:
    try:
        with zipfile.ZipFile(manifest.path) as archive:
            cloud = (
                _read_plain(archive, folder, points, manifest)
                if encoding is None
                else _read_packed(archive, folder, points, encoding, manifest)
            )
    except (OSError, KeyError, ValueError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ImportProblem(f"{manifest.path}: expected the points in {folder}, got damaged ones ({reason})") from error
    if not (np.isfinite(cloud.xyz).all() and np.isfinite(cloud.radius).all()):
        raise ImportProblem(f"{manifest.path}: expected finite points in {folder}, got NaN or infinity")
    return cloud


def _read_plain(archive: zipfile.ZipFile, folder: str, points: int, manifest: Manifest) -> Cloud:
    views = manifest.source_count

    def array(name: str, dtype: str, shape: tuple[int, ...]) -> NDArray[Any]:
        size = math.prod(shape) * np.dtype(dtype).itemsize
        return np.frombuffer(_member(archive, f"{folder}/{name}", size), dtype).reshape(shape)

    colour = np.zeros((points, 3), np.float32)
    if views:
        weights = array("blend_weights", "<f2", (points, views)).astype(np.float32)
        weights[~weights.any(axis=1)] = 1
        rgb = array("rgb", "|u1", (points, views, 3))
        for view in range(views):  # one view after the other, which needs less memory
            colour += weights[:, view, None] * rgb[:, view]
        colour /= 255 * weights.sum(axis=1, keepdims=True)
    constant = array("sh", "<f2", (points, 3, SH_TERMS))[:, :, 0].astype(np.float32)
    return Cloud(
        array("xyz", "<f4", (points, 3)),
        array("radius", "<f2", (points,)).astype(np.float32),
        array("density", "<f2", (points,)).astype(np.float32),
        _with_harmonics(colour, constant, manifest),
    )


def _read_packed(archive: zipfile.ZipFile, folder: str, points: int, encoding: Encoding, manifest: Manifest) -> Cloud:
    content = _packed(archive, f"{folder}/points", points * (encoding.code_bytes + 3))
    end = points * encoding.code_bytes
    radius_codes = _joined(content[end : end + 2 * points], 2).astype(np.float64)
    radius = encoding.radius_lower * np.exp2((radius_codes - 1) / encoding.radius_steps)
    colour = np.zeros((points, 3), np.float32)
    if manifest.source_count:
        planes = _packed(archive, f"{folder}/colour", 3 * points).reshape(3, points)
        green, red, blue = np.cumsum(planes, axis=1, dtype=np.uint8)
        colour += np.stack([red + green, green, blue + green], axis=-1) / np.float32(255)
    rows = len(encoding.sh_basis)
    codes = _joined(_packed(archive, f"{folder}/sh", 2 * rows * points), 2).astype(np.int64).reshape(rows, points)
    factors = (codes >> 1) ^ -(codes & 1)
    constant = encoding.sh_mean[::SH_TERMS] + encoding.sh_step * (factors.T @ encoding.sh_basis[:, ::SH_TERMS])
    density = content[end + 2 * points :].astype(np.float32) / encoding.density_levels
    return Cloud(
        _positions(content[:end], points, encoding),
        np.where(radius_codes > 0, radius, 0).astype(np.float32),
        np.minimum(density, 1),
        _with_harmonics(colour, constant.astype(np.float32), manifest),
    )


def _positions(content: NDArray[np.uint8], points: int, encoding: Encoding) -> NDArray[np.float32]:
    """Decode positions (N, 3) from the differences of their Morton codes."""
    codes = np.cumsum(_joined(content, encoding.code_bytes), dtype=np.uint64)
    grid = np.zeros((points, 3), np.uint64)
    one = np.uint64(1)
    for bit in range(encoding.position_bits):
        for axis in range(3):
            grid[:, axis] |= ((codes >> np.uint64(3 * bit + axis)) & one) << np.uint64(bit)
    return (encoding.lower + encoding.position_step * grid).astype(np.float32)


def _with_harmonics(
    colour: NDArray[np.float32], constant: NDArray[np.float32], manifest: Manifest
) -> NDArray[np.float32]:
    """Add the colour from the constant coefficients (N, 3) of the spherical harmonics."""
    own = manifest.sh_base + manifest.sh_range * np.tanh(SH_CONSTANT * constant)
    return np.clip(colour + own, 0, 1).astype(np.float32)


def _joined(content: NDArray[np.uint8], planes: int) -> NDArray[np.uint64]:
    """Return the values whose bytes are stored as planes, from the lowest byte to the highest."""
    rows = content.reshape(planes, -1)
    values = np.zeros(rows.shape[1], np.uint64)
    for plane in range(planes):
        values |= rows[plane].astype(np.uint64) << np.uint64(8 * plane)
    return values


def _member(archive: zipfile.ZipFile, name: str, size: int) -> bytes:
    found = archive.getinfo(name).file_size
    if found != size:
        raise ValueError(f"{name}: expected {size} bytes, got {found}")
    return archive.read(name)


def _packed(archive: zipfile.ZipFile, name: str, size: int) -> NDArray[np.uint8]:
    """Return the content of a compressed member, which must have ``size`` bytes."""
    limit = max(archive.getinfo(name).file_size * 1024, 1 << 24)
    if size > limit:
        raise ValueError(f"{name}: expected at most {limit} bytes, got {size}")
    member = archive.read(name)
    content = (
        _from_zstd(member, size) if member.startswith(ZSTD_MAGIC) else zlib.decompressobj().decompress(member, size + 1)
    )
    if len(content) != size:
        raise ValueError(f"{name}: expected {size} bytes, got {len(content)}")
    return np.frombuffer(content, np.uint8)


def _from_zstd(member: bytes, size: int) -> bytes:
    try:
        import zstandard
    except ModuleNotFoundError:
        raise ValueError(
            "Blender has no package zstandard; write the scene with fourd web, and import its scene.4dv"
        ) from None
    try:
        declared = zstandard.frame_content_size(member)
        if declared != size:
            raise ValueError(f"expected {size} bytes, got {declared}")
        return zstandard.ZstdDecompressor().decompress(member, max_output_size=max(size, 1))
    except zstandard.ZstdError as error:
        raise ValueError(f"expected Zstandard data ({error})") from error
