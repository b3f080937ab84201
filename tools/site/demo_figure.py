"""Draw docs/figures/demo.png from the output of `make demo`.

The figure shows the ground truth of a held-out view, the rendered held-out view, and three novel views.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.baking import open_scene
from fourd.capture import open_capture
from fourd.files import atomic_path
from fourd.viewer.navigation.paths import orbit

ROOT = Path(__file__).parents[2]
HEIGHT = 360
BACKGROUND = 245


def main() -> None:
    """Write docs/figures/demo.png."""
    scene, capture = open_scene(ROOT / "demo" / "scene.4dv"), open_capture(ROOT / "demo" / "capture")
    index = capture.names.index(scene.manifest.other_names[0])
    camera = capture.cameras[index].resize(HEIGHT, HEIGHT)
    matte = capture.mask(index, 0)[..., None] / 255
    truth = capture.image(index, 0) * matte + BACKGROUND * (1 - matte)
    tiles = [_titled(cv2.resize(truth.astype(np.uint8), (HEIGHT, HEIGHT)), "photograph, held out")]
    background = np.full(3, BACKGROUND / 255, np.float32)
    tiles.append(_titled(_bytes(scene.render(camera, 0, background=background).rgb), "fourd, same view"))
    path = orbit(list(scene.manifest.cameras), 12, focus=np.asarray(scene.manifest.focus), size=(HEIGHT, HEIGHT))
    for step in (2, 5, 8):
        frame = step * scene.manifest.frame_count // 12
        picture = _bytes(scene.render(path[step], frame, background=background).rgb)
        tiles.append(_titled(picture, f"new view, frame {frame}"))
    with atomic_path(ROOT / "docs" / "figures" / "demo.png") as temporary:
        cv2.imwrite(str(temporary), cv2.cvtColor(np.concatenate(tiles, axis=1), cv2.COLOR_RGB2BGR))


def _bytes(rgb: NDArray[np.float32]) -> NDArray[np.uint8]:
    return (rgb.clip(0, 1) * 255 + 0.5).astype(np.uint8)


def _titled(tile: NDArray[np.uint8], title: str) -> NDArray[np.uint8]:
    """Crop an image to the middle two thirds of its width, and write a title in the top left corner."""
    side = HEIGHT // 6
    tile = np.ascontiguousarray(tile[:, side:-side])
    return np.asarray(cv2.putText(tile, title, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (60, 60, 60), 1, cv2.LINE_AA))


if __name__ == "__main__":
    main()
