"""Open a .4dv scene and render one frame, without torch.

    python examples/draw_scene.py scene.4dv --frame 3 --degrees 20 --out view.png

The program takes one of the capture's cameras and rotates it about the scene's centre by --degrees.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from PIL import Image

from fourd import Camera, Player, open_scene


@dataclass(frozen=True)
class Arguments:
    """The scene, the frame and the camera to draw."""

    scene: tyro.conf.Positional[Path]
    """The .4dv file."""
    out: Path = Path("view.png")
    """The image to write, a PNG with alpha."""
    frame: int = 0
    """Index of the frame, from 0."""
    camera: str | None = None
    """Name of the camera in the capture. The default is the first camera."""
    degrees: float = 0.0
    """Rotation of the camera about the scene's centre, in degrees."""


def main(arguments: Arguments) -> None:
    """Render the frame, write the image and print a summary."""
    with open_scene(arguments.scene) as scene:
        manifest = scene.manifest
        camera = manifest.cameras[0] if arguments.camera is None else manifest.camera(arguments.camera)
        camera = orbit(camera, np.asarray(manifest.focus), np.deg2rad(arguments.degrees))
        frame = scene.frame(arguments.frame)
        rgba = Player().draw(frame, camera, manifest)  # (H, W, 4) uint8
    Image.fromarray(rgba).save(arguments.out)
    print(f"{arguments.scene}: {manifest.frame_count} frames, {manifest.view_count} source views, {manifest.fps:g} fps")
    print(f"wrote {arguments.out}: frame {arguments.frame}, {len(frame.xyz)} points, {camera.width} x {camera.height}")


def orbit(camera: Camera, centre: np.ndarray, radians: float) -> Camera:
    """Return the camera rotated about ``centre`` (3,). The rotation axis is parallel to the image's y axis."""
    x, y, z = camera.rotation[1]  # the image's y axis in world coordinates
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.eye(3) + np.sin(radians) * skew + (1 - np.cos(radians)) * skew @ skew  # Rodrigues' formula
    rotation = camera.rotation @ turn.T
    position = centre + turn @ (camera.centre - centre)
    return replace(camera, rotation=rotation, translation=-rotation @ position)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
