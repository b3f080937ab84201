"""Run ``make demo``: make a synthetic capture, train and export a scene, render a video and compute scores.

The program prints and runs the commands that a user would type.
"""

from __future__ import annotations

import json
import shlex
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import command_line
from fourd.base.files import atomic_path
from fourd.cli.main import main as fourd
from fourd.recording.capture import open_capture
from fourd.scene import Scene, open_scene
from fourd.viewer.navigation.paths import orbit

TEST_VIEWS = "03,09"
FIGURE_HEIGHT = 360
FIGURE_BACKGROUND = 245


@dataclass(frozen=True)
class Arguments:
    """Options of the demonstration."""

    folder: Path = Path("demo")
    """Folder for all files. Stages whose results it already contains are skipped."""
    steps: int = 2400
    """Steps of the training. A limit in steps and not in seconds, so that every machine reaches the same quality."""
    figure: Path | None = None
    """PNG file for a figure of the ground truth and the rendering of a held-out view, and of three novel views.
    docs/figures/demo.png is such a figure."""


def program() -> str:
    """Return how to call fourd in this terminal: by its name, or by its path if the shell would not find it."""
    beside = Path(sys.executable).with_name("fourd")
    if shutil.which("fourd") is not None or not beside.exists():
        return "fourd"
    return str(beside.relative_to(Path.cwd()) if beside.is_relative_to(Path.cwd()) else beside)


def step(*words: object) -> None:
    """Print and run one fourd command. Exit if the command fails."""
    arguments = [str(word) for word in words]
    print(f"\n$ {shlex.join([program(), *arguments])}", flush=True)
    code = fourd(arguments)
    if code != 0:
        sys.exit(code)


def draw_figure(scene_path: Path, capture_path: Path, out: Path) -> None:
    """Write the figure of the option --figure."""
    scene, capture = open_scene(scene_path), open_capture(capture_path)
    index = capture.names.index(scene.manifest.other_names[0])
    camera = capture.cameras[index].resize(FIGURE_HEIGHT, FIGURE_HEIGHT)
    matte = capture.mask(index, 0)[..., None] / 255
    truth = capture.image(index, 0) * matte + FIGURE_BACKGROUND * (1 - matte)
    tiles = [_titled(cv2.resize(truth.astype(np.uint8), (FIGURE_HEIGHT, FIGURE_HEIGHT)), "ground truth, held out")]
    tiles.append(_titled(_rendered(scene, camera, 0), "fourd, same view"))
    focus = np.asarray(scene.manifest.focus)
    path = orbit(list(scene.manifest.cameras), 12, focus=focus, size=(FIGURE_HEIGHT, FIGURE_HEIGHT))
    for place in (2, 5, 8):
        frame = place * scene.manifest.frame_count // 12
        tiles.append(_titled(_rendered(scene, path[place], frame), f"new view, frame {frame}"))
    with atomic_path(out) as temporary:
        cv2.imwrite(str(temporary), cv2.cvtColor(np.concatenate(tiles, axis=1), cv2.COLOR_RGB2BGR))


def _rendered(scene: Scene, camera: Camera, frame: int) -> NDArray[np.uint8]:
    background = np.full(3, FIGURE_BACKGROUND / 255, np.float32)
    return (scene.render(camera, frame, background=background).rgb.clip(0, 1) * 255 + 0.5).astype(np.uint8)


def _titled(tile: NDArray[np.uint8], title: str) -> NDArray[np.uint8]:
    """Crop an image to the middle two thirds of its width, and write a title in the top left corner."""
    side = FIGURE_HEIGHT // 6
    tile = np.ascontiguousarray(tile[:, side:-side])
    return np.asarray(cv2.putText(tile, title, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (60, 60, 60), 1, cv2.LINE_AA))


def main() -> None:
    """Make all files of the demonstration, and skip stages that are already finished."""
    arguments = tyro.cli(Arguments, description=__doc__)
    started = time.monotonic()
    folder = arguments.folder
    capture, scene, video = folder / "capture", folder / "scene.4dv", folder / "orbit.mp4"
    figures, run = folder / "eval.json", folder / "scene.work" / "run"
    if not (capture / "intri.yml").exists():
        step("synth", capture, "--frames", 16, "--cameras", 16, "--size", 320)
    step("make", capture, "-o", scene, "--test-views", TEST_VIEWS, "--max-steps", arguments.steps)
    step("eval", run, "--json", figures)
    step("render", scene, "--path", "orbit", "--out", video, "--size", 512, 512)
    if arguments.figure is not None:
        draw_figure(scene, capture, arguments.figure)
    scores = json.loads(figures.read_text())
    megabytes = scene.stat().st_size / 1e6
    print(
        f"\nFinished in {time.monotonic() - started:.0f} s: {scene} ({megabytes:.0f} MB) and {video}."
        f"\nHeld-out cameras {TEST_VIEWS}: {scores['image']['psnr']:.2f} dB PSNR on the whole image, "
        f"{scores['box']['psnr']:.2f} dB in the foreground's box."
        f"\nNext: {command_line(program(), 'view', scene)}; open {video}; "
        f"{command_line(program(), 'render', scene, '--path', 'spiral', '--out', 'spiral.mp4')}; "
        f"{program()} make YOUR_CAPTURE -o scene.4dv"
    )


if __name__ == "__main__":
    main()
