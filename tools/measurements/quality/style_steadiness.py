"""Measure how many line pixels of each style flicker although neither the camera nor the true surface moves.

    fourd mesh captures/fox_run -o meshes
    python tools/measurements/quality/style_steadiness.py fox.4dv meshes
    python tools/measurements/quality/style_steadiness.py fox.4dv --renderer sorted

The meshes give the true depth and normal of each pixel. A pixel is unchanged over three successive frames if the true
depth changes by at most 2% and the true normal by at most 15 degrees, at the pixel itself and at all pixels up to
``--reach`` pixels away. An unchanged pixel is an edge pixel if it has a line in at least one of the three frames. An
edge pixel flickers if its line is present only in the middle frame, or is missing only in the middle frame. If no
meshes are given, the depth and normals that fourd draws without averaging over time serve as the true ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated

import cv2
import moderngl
import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from rich.progress import track

from fourd.base.cameras import Camera
from fourd.base.formats.glb_mesh import read_glb_mesh
from fourd.reconstruction.meshes.views import depth_image
from fourd.scene import BakedFrame, Scene, open_scene
from fourd.scene.styled.normals import add_normals
from fourd.scene.styled.player import StyledPlayer
from fourd.scene.styles import Style, load_style
from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.gl.canvas import Canvas
from fourd.viewer.gl.context import offscreen_context
from fourd.viewer.navigation.paths import fit_camera
from fourd.viewer.rendering.cpu import CPURenderer
from fourd.viewer.rendering.renderers import Renderer, RendererName, make_renderer
from tools.measurements import tables

SAME_DEPTH = 0.02
SAME_NORMAL = float(np.cos(np.radians(15)))
VISIBLE = 128
"""A pixel counts as a line pixel if its line strength, from 0 to 255, is at least this value."""


@dataclass(frozen=True)
class Arguments:
    """The scene, optional reference meshes, and the styles to measure."""

    scene: tyro.conf.Positional[Path]
    """A .4dv file."""
    meshes: tyro.conf.Positional[Annotated[Path | None, tyro.conf.arg(metavar="DIR")]] = None
    """Output folder of fourd mesh for the same capture."""
    styles: tuple[str, ...] = ("toon", "xtoon", "gooch", "ink")
    """Names of presets, or style files."""
    views: tuple[str, ...] = ("00", "05", "10", "15")
    """Names of the static cameras."""
    renderer: RendererName = "cpu"
    """The renderer that draws the lines."""
    size: tuple[int, int] = (960, 540)
    """Width and height of the images in pixels."""
    reach: int = 2
    """Distance in pixels. A pixel counts as unchanged only if the true surface stays the same at all pixels up to this
    distance away."""


@dataclass(frozen=True, eq=False)
class Truth:
    """The true surface of an image: unit normals (H, W, 3), and inverse depth (H, W), which is 0 where there is no
    surface."""

    inverse_depth: NDArray[np.float32]
    normal: NDArray[np.float32]


@dataclass
class Count:
    """The number of edge pixels (unchanged pixels that have a line in at least one of three successive frames), and how
    many of them flicker."""

    edges: int = 0
    flickering: int = 0

    @property
    def percent(self) -> float:
        return 100 * self.flickering / max(self.edges, 1)

    def add(self, lines: list[NDArray[np.bool_]], is_still: NDArray[np.bool_]) -> None:
        """Count the edge pixels and the flickering pixels of three successive frames, and add them to the totals.
        ``lines`` are the masks of line pixels in these frames, and ``is_still`` is the mask of unchanged pixels."""
        before, now, after = lines
        self.edges += int((is_still & (before | now | after)).sum())
        self.flickering += int((is_still & (now != before) & (now != after)).sum())


def main(arguments: Arguments) -> None:
    """Print the percentage of edge pixels that flicker in each style.

    Each style is measured twice: once as it is, and once without the two methods by which fourd reduces flicker
    (averaging over successive images, and hysteresis).
    """
    scene = open_scene(arguments.scene)
    manifest = scene.manifest
    views = dict(zip(manifest.names, manifest.cameras, strict=True))
    styles = {}
    for name in arguments.styles:
        style = load_style(name)
        styles[name, "steady"] = style
        styles[name, "off"] = replace(style, persistence=0.0, hysteresis=0.0)
    counts = {key: Count() for key in styles}
    context = None if arguments.renderer == "cpu" else offscreen_context()
    for name in arguments.views:
        camera = fit_camera(views[name], *arguments.size)
        for count, found in zip(
            counts.values(), measure_view(scene, arguments, camera, list(styles.values()), context), strict=True
        ):
            count.edges += found.edges
            count.flickering += found.flickering
    titles = ["style", "edge pixels", "flickering", "edge pixels without steadying", "flickering without steadying"]
    print(tables.head(titles))
    for name in arguments.styles:
        steady, off = counts[name, "steady"], counts[name, "off"]
        counted = [f"{steady.edges:,}", f"{steady.percent:.2f}%", f"{off.edges:,}", f"{off.percent:.2f}%"]
        print(tables.row([name, *counted]))


def measure_view(
    scene: Scene, arguments: Arguments, camera: Camera, styles: list[Style], context: moderngl.Context | None
) -> list[Count]:
    """Count the edge pixels of each style in the images of one camera. ``context`` is None for the cpu renderer."""
    renderers = [make_renderer(arguments.renderer, context) for _ in styles]
    canvas = None if context is None else Canvas(context)
    history: list[list[NDArray[np.bool_]]] = [[] for _ in styles]
    counts = [Count() for _ in styles]
    still: list[NDArray[np.bool_]] = []
    last: Truth | None = None
    for index, truth in enumerate(_truths(scene, arguments.meshes, camera)):
        for renderer, style, lines in zip(renderers, styles, history, strict=True):
            settings = DisplaySettings(scene.manifest.layers, style=style)
            _draw(renderer, RenderRequest(_frame(scene, index), camera, scene.manifest, settings), canvas)
            lines.append(renderer.line_strength >= VISIBLE)
            del lines[:-3]
        if last is not None:
            still = [*still, _is_same(last, truth, arguments.reach)][-2:]
        last = truth
        if index >= 2:
            for count, lines in zip(counts, history, strict=True):
                count.add(lines, still[0] & still[1])
    for item in (*renderers, *(() if canvas is None else (canvas,))):
        item.release()
    return counts


def _draw(renderer: Renderer, request: RenderRequest, canvas: Canvas | None) -> None:
    if isinstance(renderer, CPURenderer):
        renderer.render(request)
    elif canvas is not None:
        renderer.draw(request, canvas, wait=True)


@cache
def _frame(scene: Scene, index: int) -> BakedFrame:
    """Return a frame with normals, which are estimated if the scene has none."""
    frame = scene.frame(index)
    return frame if frame.normals is not None else add_normals(frame, scene.manifest)


def _truths(scene: Scene, meshes: Path | None, camera: Camera) -> Iterator[Truth]:
    player = StyledPlayer()
    numbers = scene.manifest.frame_numbers
    for index in track(range(len(numbers)), description="frames"):
        if meshes is None:
            surface = player.draw_surface(_frame(scene, index), camera, scene.manifest)
            yield Truth(surface.inverse_depth.copy(), surface.unit_normal.copy())
        else:
            mesh = read_glb_mesh(meshes / f"{numbers[index]:06d}.glb")
            depth = depth_image(torch.from_numpy(mesh.xyz), torch.from_numpy(mesh.triangles), camera)
            yield Truth((1 / depth).astype(np.float32), _normals_of_depth(depth, camera))


def _normals_of_depth(depth: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Compute unit normals from a depth map. Next to pixels without a surface, they are 0."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], 2) @ np.linalg.inv(camera.intrinsics).T
    with np.errstate(invalid="ignore"):
        points = rays * cv2.blur(depth, (3, 3))[..., None]
        normal = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
        normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    return np.nan_to_num(normal).astype(np.float32)


def _is_same(first: Truth, second: Truth, reach: int) -> NDArray[np.bool_]:
    """Return a mask (H, W) that is true where both frames show the same true surface, not only at the pixel itself but
    also at all pixels up to ``reach`` rows and columns away. The surface at a pixel is the same if the depths and the
    normals of the two frames are almost equal. Unknown normals are not compared."""
    a, b = first.inverse_depth, second.inverse_depth
    has_depth = np.abs(a - b) <= SAME_DEPTH * np.maximum(a, b)
    cosine = (first.normal * second.normal).sum(2)
    is_unknown = (np.abs(first.normal).sum(2) == 0) | (np.abs(second.normal).sum(2) == 0)
    same = has_depth & ((cosine >= SAME_NORMAL) | is_unknown)
    side = 2 * reach + 1
    return cv2.erode(same.astype(np.uint8), np.ones((side, side), np.uint8)) > 0


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
