"""Computes a mesh's texture from the images of its frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.formats.glb_mesh import read_glb_mesh
from fourd.reconstruction.meshes.settings import MAX_TEXTURE_SIZE
from fourd.reconstruction.meshes.surface.losses import vertex_normals
from fourd.reconstruction.meshes.texturing.atlas import build_atlas, find_texels
from fourd.reconstruction.meshes.texturing.blending import blend_views
from fourd.reconstruction.meshes.texturing.inpainting import fill_between_charts, fill_vertices
from fourd.reconstruction.meshes.texturing.visibility import Occluder
from fourd.reconstruction.meshes.views import MeshView


@dataclass(frozen=True, eq=False)
class TexturedMesh:
    """A triangle mesh with a texture. A vertex at a chart border occurs once for each chart that contains it.

    Attributes:
        xyz: (N, 3) float32 vertices in world units.
        triangles: (M, 3) int32 vertex indices, counter-clockwise seen from outside.
        normals: (N, 3) float32 outward unit normals.
        uv: (N, 2) float32 texture coordinates in [0, 1]. (0, 0) is the upper left corner of the texture.
        texture: (S, S, 3) uint8 RGB colours.
    """

    xyz: NDArray[np.float32]
    triangles: NDArray[np.int32]
    normals: NDArray[np.float32]
    uv: NDArray[np.float32]
    texture: NDArray[np.uint8]


def read_textured_mesh(path: Path) -> TexturedMesh:
    """Read a mesh from a GLB file that ``fourd mesh`` wrote.

    Raises:
        UserError: if the file is missing or damaged, or its mesh has no texture.
    """
    mesh = read_glb_mesh(path, MAX_TEXTURE_SIZE)
    if mesh.normals is None or mesh.uv is None or mesh.texture is None:
        raise UserError(f"{path}: expected a mesh with a texture, got none; run fourd mesh again")
    return TexturedMesh(mesh.xyz, mesh.triangles, mesh.normals, mesh.uv, mesh.texture)


def texture_mesh(
    xyz: NDArray[np.float32], triangles: NDArray[np.integer], views: Sequence[MeshView], size: int
) -> TexturedMesh:
    """Compute a mesh's texture from the views of its frame.

    Each texel's colour is blended from the views that see it
    (:func:`fourd.reconstruction.meshes.texturing.blending.blend_views`). Texels that no view sees get colours from the
    surrounding surface.

    Args:
        xyz: (N, 3) vertices in world units.
        triangles: (M, 3) vertex indices, at least one triangle.
        views: views of the frame, at least one.
        size: side length of the texture in texels, at least 16.

    Raises:
        ValueError: if the mesh or ``views`` is empty, a vertex is not finite or ``size`` is too small.
    """
    if not views:
        raise ValueError("views: expected at least one view, got none")
    atlas = build_atlas(xyz, triangles, size)
    texels = find_texels(atlas, size)
    normals, occluder = _normals(xyz, triangles), Occluder.of(xyz, triangles)
    corners = atlas.source[atlas.triangles]
    at, facing = texels.interpolate(xyz, corners), _unit(texels.interpolate(normals, corners))
    rgb, weight = blend_views(at, facing, views, occluder)
    unseen = weight <= 0
    if unseen.any():
        of_vertices = _vertex_colours(xyz, normals, triangles, views, occluder)
        rgb[unseen] = texels.interpolate(of_vertices, corners)[unseen]
    texture = np.zeros((size, size, 3), np.float32)
    texture[texels.covered] = rgb
    texture = fill_between_charts(texture, texels.covered)
    return TexturedMesh(
        xyz[atlas.source],
        atlas.triangles,
        normals[atlas.source],
        atlas.uv,
        _to_bytes(texture),
    )


def colour_mesh(
    xyz: NDArray[np.float32], triangles: NDArray[np.integer], views: Sequence[MeshView]
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Compute a mesh's vertex colours from the views of its frame, with the method with which :func:`texture_mesh`
    computes texel colours.

    Args:
        xyz: (N, 3) vertices in world units.
        triangles: (M, 3) vertex indices.
        views: views of the frame, at least one.

    Returns:
        outward unit normals (N, 3) and colours (N, 3) uint8 of the vertices.

    Raises:
        ValueError: if ``views`` is empty.
    """
    if not views:
        raise ValueError("views: expected at least one view, got none")
    normals = _normals(xyz, triangles)
    rgb = _vertex_colours(xyz, normals, triangles, views, Occluder.of(xyz, triangles))
    return normals, _to_bytes(rgb)


def _normals(xyz: NDArray[np.float32], triangles: NDArray[np.integer]) -> NDArray[np.float32]:
    """Return the outward unit normals (N, 3) of the vertices."""
    faces = torch.from_numpy(np.asarray(triangles, np.int64))
    return np.asarray(vertex_normals(torch.from_numpy(xyz), faces).numpy(), np.float32)


def _vertex_colours(
    xyz: NDArray[np.float32],
    normals: NDArray[np.float32],
    triangles: NDArray[np.integer],
    views: Sequence[MeshView],
    occluder: Occluder,
) -> NDArray[np.float32]:
    """Compute the colours (N, 3) of all vertices in [0, 1], including vertices that no view sees."""
    rgb, weight = blend_views(xyz, normals, views, occluder)
    return fill_vertices(rgb, weight > 0, triangles)


def _to_bytes(rgb: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.rint(rgb.clip(0, 1) * 255).astype(np.uint8)


def _unit(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), np.float32(1e-12))
