"""Compare the web player with other viewers on one frame of a scene, in Chromium.

    python tools/measurements/web/compare_viewers.py scene.4dv --frame 12 -o build/viewers

The program exports the frame as Gaussian splats (3DGS PLY). It shows the exported file in Spark and in
supersplat-viewer (npm packages @sparkjsdev/spark and @playcanvas/supersplat-viewer). fourd's web player, the HTML
element <fourd-player>, shows the scene. All viewers show the frame from the last camera of the scene. The program
writes their images and those of `fourd.scene.player.Player` as PNG files. It prints a Markdown table with the PSNR of
each viewer's image relative to the images of `Player`, and with the images per second while the camera moves.
"""

from __future__ import annotations

import base64
import io
import shutil
import statistics
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image

from fourd.base.cameras import Camera
from fourd.reconstruction.training.evaluation.metrics import psnr
from fourd.scene import open_scene
from fourd.scene.exporting.export import ExportSettings, export_scene
from fourd.scene.player import Player
from fourd.scene.splats.reader import SplatReader
from fourd.viewer.publish.site import write_site
from tools.measurements import tables
from tools.measurements.web.pages import open_pages

HERE = Path(__file__).parent
PACKAGES = (
    "three@0.187.0",
    "@sparkjsdev/spark@2.2.0",
    "playcanvas@2.22.1",
    "@playcanvas/supersplat-viewer@1.36.2",
)
PAGES = {
    "Spark": ("spark", ("three/build", "@sparkjsdev/spark/dist", "three/examples/jsm")),
    "supersplat-viewer": (
        "supersplat",
        ("playcanvas/build", "playcanvas/scripts", "@playcanvas/supersplat-viewer/dist"),
    ),
}
"""The viewers that show the exported PLY file. The name of each viewer maps to the name of its page in this folder, and
to the folders of the npm packages that the page loads."""
NEAR, FAR = 0.05, 50.0
PATH_STEPS, STEP_DEGREES = 90, 0.5
PLAYER = """
    window.viewer = (async () => {
        const player = document.querySelector("fourd-player");
        while (!player.firstImageMs) await new Promise((resolve) => setTimeout(resolve, 20));
        player.seek(FRAME);
        await player.settled();
        const {stage} = player;
        stage.isSuspended = true;
        const draw = ({camera}) => {
            stage.playback.update(0, camera);
            stage.fixedCamera = camera;
            stage.redraw();
        };
        return {draw, canvas: player.panel.canvas};
    })();
"""
"""A script for the page with <fourd-player>. It defines ``window.viewer``, which loop.js documents."""


@dataclass(frozen=True)
class Arguments:
    """The frame to show, and the duration of the measurements."""

    scene: tyro.conf.Positional[Path]
    """A .4dv file with source views."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the images and the pages."""
    frame: int = 0
    """Index of the frame in the scene, from 0."""
    size: int = 512
    """Width and height of the images in pixels."""
    rounds: int = 5
    """Number of measurements of each viewer. The viewers take turns."""
    seconds: float = 5.0
    """Duration of one measurement in seconds."""


def main() -> None:
    arguments = tyro.cli(Arguments, description=__doc__)
    scene = open_scene(arguments.scene)
    camera = scene.manifest.cameras[-1].resize(arguments.size, arguments.size)
    cameras = [describe(camera), *map(describe, path_of(camera, np.array(scene.manifest.focus)))]
    drawn = Player().draw(scene.frame(arguments.frame), camera, scene.manifest)
    expected, subject = drawn[..., :3], drawn[..., 3] > 0
    write_pages(arguments, scene)
    splats = SplatReader(arguments.out / "frame.ply")
    points = Player().draw(splats.read(0), camera, splats.manifest)[..., :3]
    pictures = {"Player": expected, "Player, exported file": points}
    speeds: dict[str, list[float]] = {}
    addresses = {
        "fourd-player": (arguments.out / "site", ""),
        **{viewer: (arguments.out / name, f"{name}.html?size={arguments.size}") for viewer, (name, _) in PAGES.items()},
    }
    with open_pages(addresses, arguments.size) as pages:
        pages["fourd-player"].evaluate(PLAYER.replace("FRAME", str(arguments.frame)))
        for page in pages.values():
            page.evaluate((HERE / "loop.js").read_text())
        for name, page in pages.items():
            content = base64.b64decode(page.evaluate("(camera) => picture(camera)", cameras[0]))
            pictures[name] = np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))
        for _ in range(arguments.rounds):
            for name, page in pages.items():
                speed = page.evaluate("([path, time]) => imagesPerSecond(path, time)", [cameras[1:], arguments.seconds])
                speeds.setdefault(name, []).append(speed)
    for name, picture in pictures.items():
        Image.fromarray(picture).save(arguments.out / f"{name.replace(', ', '_').replace(' ', '_').lower()}.png")
    print_table(pictures, subject, speeds)


def write_pages(arguments: Arguments, scene: Any) -> None:
    """Write one page per viewer. <fourd-player> shows the scene, and the other viewers show the exported frame."""
    out = arguments.out
    npm = out / "npm"
    npm.mkdir(parents=True, exist_ok=True)
    subprocess.run(["npm", "install", "--prefix", npm, "--no-audit", "--no-fund", "--silent", *PACKAGES], check=True)
    write_site(arguments.scene, out / "site", "full")
    settings = ExportSettings("ply-sequence", (arguments.frame,), degree=3, keep_axes=True)
    export_scene(scene, out / "frame.ply", settings)
    for name, folders in PAGES.values():
        page = out / name
        shutil.rmtree(page, ignore_errors=True)
        page.mkdir()
        for source in (HERE / f"{name}.html", HERE / f"{name}.js", out / "frame.ply"):
            shutil.copyfile(source, page / source.name)
        for folder in folders:
            shutil.copytree(npm / "node_modules" / folder, page / "npm" / folder)


def path_of(camera: Camera, focus: NDArray[np.float64]) -> list[Camera]:
    """Return the cameras of a path that moves back and forth on an arc around the focus. The arc's axis is parallel to
    the up direction of ``camera``."""
    steps = np.concatenate([np.arange(PATH_STEPS), np.arange(PATH_STEPS)[::-1]])
    return [turned(camera, focus, np.radians(STEP_DEGREES * step)) for step in steps]


def turned(camera: Camera, focus: NDArray[np.float64], angle: float) -> Camera:
    """Rotate ``camera`` about the axis through the focus that is parallel to the camera's up direction.

    The rotated camera shows the same image as the unrotated camera would if the scene were rotated by ``angle``.
    """
    x, y, z = camera.rotation[1]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    rotation = camera.rotation @ turn
    return replace(camera, rotation=rotation, translation=camera.translation + (camera.rotation - rotation) @ focus)


def describe(camera: Camera) -> dict[str, Any]:
    """Return the camera's parameters for <fourd-player>, and its OpenGL matrices for the other viewers."""
    k, width, height = camera.intrinsics, camera.width, camera.height
    view, projection = np.eye(4), np.zeros((4, 4))
    view[:3, :3], view[:3, 3] = camera.rotation, camera.translation
    projection[0, 0], projection[0, 2] = 2 * k[0, 0] / width, 1 - 2 * k[0, 2] / width
    projection[1, 1], projection[1, 2] = 2 * k[1, 1] / height, 2 * k[1, 2] / height - 1
    projection[2, 2:] = (FAR + NEAR) / (NEAR - FAR), 2 * FAR * NEAR / (NEAR - FAR)
    projection[3, 2] = -1
    return {
        "camera": {
            "intrinsics": k.ravel().tolist(),
            "rotation": camera.rotation.ravel().tolist(),
            "translation": camera.translation.tolist(),
            "width": width,
            "height": height,
        },
        "view": (np.diag([1.0, -1, -1, 1]) @ view).ravel("F").tolist(),
        "projection": projection.ravel("F").tolist(),
    }


def print_table(
    pictures: dict[str, NDArray[np.uint8]], subject: NDArray[np.bool_], speeds: dict[str, list[float]]
) -> None:
    """Print the errors of the whole images, the errors of the pixels that show the subject, and the speeds."""
    titles = ["picture", "PSNR to the scene", "subject", "PSNR to the file", "subject", "images per second", "range"]
    print(tables.head(titles))
    for name, picture in pictures.items():
        references = (pictures["Player"], pictures["Player, exported file"])
        errors = [error(picture[where], other[where]) for other in references for where in (np.s_[:], subject)]
        values = speeds.get(name)
        speed = [f"{statistics.median(values):.1f}", f"{min(values):.1f} to {max(values):.1f}"] if values else ["", ""]
        print(tables.row([name, *errors, *speed]))


def error(got: NDArray[np.uint8], expected: NDArray[np.uint8]) -> str:
    return "" if np.array_equal(got, expected) else f"{float(psnr(got / 255, expected / 255)):.1f} dB"


if __name__ == "__main__":
    main()
