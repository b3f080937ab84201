"""Draw a turntable of meshes. For each GLB file from `fourd mesh`, one row shows the textured mesh, and one row shows
the surface in shaded grey.

python tools/figures/turntable.py FRAME.glb [FRAME.glb ...] -o turntable.jpg
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at
from fourd.base.formats.glb_mesh import read_glb_mesh
from fourd.reconstruction.meshes.rendering import render_mesh
from fourd.reconstruction.meshes.texturing.texture import TexturedMesh, read_textured_mesh
from fourd.reconstruction.meshes.views import clip_positions
from fourd.rendering.triangles import interpolate, rasterize

SIDE_PX, STEPS, SAMPLES, GREY = 300, 6, 3, 0.93
ELEVATION = 0.25
"""Elevation of the cameras in radians."""


def turntable(mesh: TexturedMesh, up: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return two rows of images, one textured and one shaded."""
    centre = (mesh.xyz.min(axis=0) + mesh.xyz.max(axis=0)).astype(np.float64) / 2
    reach = float(np.linalg.norm(mesh.xyz - centre, axis=1).max())
    side = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    side /= np.linalg.norm(side)
    front = np.cross(up, side)
    focal = 1.35 * SIDE_PX
    intrinsics = np.array([[focal, 0, SIDE_PX / 2], [0, focal, SIDE_PX / 2], [0, 0, 1]])
    rows: tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]] = ([], [])
    for step in range(STEPS):
        angle = 2 * np.pi * step / STEPS + 0.4
        direction = np.cos(ELEVATION) * (np.cos(angle) * side + np.sin(angle) * front) + np.sin(ELEVATION) * up
        camera = look_at(centre + 2.75 * reach * direction, centre, up, intrinsics, SIDE_PX, SIDE_PX)
        image = render_mesh(mesh, camera, SAMPLES)
        empty = GREY * (1 - image.alpha[..., None])
        rows[0].append(image.rgb + empty)
        rows[1].append(shade(mesh, camera, 0.8 * direction + 0.3 * up + 0.3 * camera.rotation[0]) + empty)
    return np.concatenate([np.concatenate(row, axis=1) for row in rows])


def shade(mesh: TexturedMesh, camera: Camera, light: NDArray[np.float64]) -> NDArray[np.float32]:
    """Render the surface with diffuse grey shading on a black background, to an image (H, W, 3)."""
    fine = camera.resize(camera.width * SAMPLES, camera.height * SAMPLES)
    clip, triangles = clip_positions(torch.from_numpy(mesh.xyz), fine)[None], torch.from_numpy(mesh.triangles)
    rast, _ = rasterize(clip.contiguous(), triangles, (fine.height, fine.width), grad_db=False)
    normals, _ = interpolate(torch.from_numpy(mesh.normals)[None], rast, triangles)
    grey = (normals[0].numpy() @ light.astype(np.float32)).clip(0, 1) * (rast[0, ..., 3] > 0).numpy()
    small = cv2.resize(grey.astype(np.float32), (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.repeat(small[..., None], 3, axis=2).astype(np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    arguments = parser.parse_args()
    figure = np.concatenate([turntable(read_textured_mesh(path), read_glb_mesh(path).up) for path in arguments.meshes])
    pixels = (figure.clip(0, 1) * 255 + 0.5).astype(np.uint8)
    cv2.imwrite(str(arguments.out), pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main()
