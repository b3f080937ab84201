"""Draw, for a held-out view, the image of the capture and the meshes of `fourd fit-triangles`: separate triangles, the
connected mesh, and the connected mesh in grey.

python tools/figures/fitted_mesh.py CAPTURE VIEW SEPARATE.ply MESH.ply [...] -o fitted_mesh.jpg
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.reconstruction.meshes.triangle_fitting.opaque import ColouredMesh, mesh_image
from fourd.reconstruction.training.evaluation.metrics import mask_box
from fourd.recording.capture import open_capture

HEIGHT_PX, GAP_PX = 420, 12


def load_mesh(path: Path) -> ColouredMesh:
    """Read a mesh from a PLY file."""
    mesh = trimesh.load(path, process=False)
    rgb = np.asarray(mesh.visual.vertex_colors[:, :3], np.uint8)
    return ColouredMesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32), rgb)


def shaded(mesh: ColouredMesh, camera: Camera) -> NDArray[np.float32]:
    """Render the mesh as a diffuse grey surface, lit from above the camera, to an image (H, W, 3)."""
    normals = trimesh.Trimesh(mesh.xyz, mesh.triangles, process=False).vertex_normals
    light = -camera.forward + 0.5 * camera.rotation[0] - 0.6 * camera.rotation[1]
    light /= np.linalg.norm(light)
    grey = (255 * (0.15 + 0.8 * (normals @ light).clip(0, 1))).astype(np.uint8)
    return mesh_image(ColouredMesh(mesh.xyz, mesh.triangles, np.repeat(grey[:, None], 3, axis=1)), camera)


def images_of(folder: Path, view: str, separate: Path, connected: Path) -> list[NDArray[np.float32]]:
    """Return four images of a view: the image of the capture, the mesh of separate triangles, the connected mesh, and
    the connected mesh in grey. All images are cropped to the subject and scaled to the same height."""
    capture = open_capture(folder)
    index = capture.names.index(view)
    camera, matte = capture.cameras[index], capture.mask(index, 0)
    photo = capture.image(index, 0) * (matte[..., None] / 255**2)
    box = mask_box(matte)
    assert box is not None, f"{view} shows no subject"
    mesh = load_mesh(connected)
    images = [photo, mesh_image(load_mesh(separate), camera), mesh_image(mesh, camera), shaded(mesh, camera)]
    parts = [np.asarray(image[box[0] : box[1], box[2] : box[3]], np.float32) for image in images]
    width = round(HEIGHT_PX * parts[0].shape[1] / parts[0].shape[0])
    return [np.asarray(cv2.resize(part, (width, HEIGHT_PX), interpolation=cv2.INTER_CUBIC)) for part in parts]


def centred(image: NDArray[np.float32], width: int) -> NDArray[np.float32]:
    """Pad an image with black to the given width, with the image in the middle."""
    left = (width - image.shape[1]) // 2
    return np.pad(image, ((0, GAP_PX), (left, width - image.shape[1] - left), (0, 0)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("inputs", nargs="+", help="CAPTURE VIEW SEPARATE.ply MESH.ply for each row")
    parser.add_argument("-o", "--out", type=Path, required=True)
    arguments = parser.parse_args()
    words = arguments.inputs
    rows = [
        images_of(Path(a), b, Path(c), Path(d)) for a, b, c, d in zip(*(words[i::4] for i in range(4)), strict=True)
    ]
    width = max(images[0].shape[1] for images in rows)
    figure = np.concatenate([np.concatenate([centred(image, width) for image in images], axis=1) for images in rows])
    pixels = (figure[:-GAP_PX].clip(0, 1) * 255 + 0.5).astype(np.uint8)
    cv2.imwrite(str(arguments.out), pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main()
