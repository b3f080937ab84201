"""Print two Markdown tables with the speed and the image errors of the viewer's renderers.

    python tools/measurements/speed/viewer_table.py

    python tools/measurements/speed/viewer_table.py scene.4dv --frame 3

If no scene is given, the program draws 262,144 points of the synthetic benchmark scene at 1920 x 1080; otherwise, it
draws one frame of the scene from its first camera. The reference for the errors is the CPU renderer that computes in
float32, with the function render_points_numpy.
"""

from __future__ import annotations

import statistics
import sys
import time
from dataclasses import dataclass, field, replace
from typing import Any

import moderngl
import numpy as np
import tyro
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.rendering.ops.points.arrays import render_points_numpy
from fourd.scene import BakedFrame, SceneManifest
from fourd.scene.shade import shade_reference
from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.gl.canvas import Canvas
from fourd.viewer.gl.context import driver_name, offscreen_context
from fourd.viewer.rendering.renderers import RENDERERS, Renderer, RendererName, make_renderer
from tools.measurements import tables
from tools.measurements.speed.drawn_frame import DrawnFrame

LAYERS = (15, 12, 8)
TURN = 1e-4
"""Angle in radians by which the camera turns between two images. It prevents renderers from reusing the last image."""


@dataclass(frozen=True)
class Arguments:
    """The scene to draw, and the time to spend on each renderer."""

    drawn: tyro.conf.OmitArgPrefixes[DrawnFrame] = field(default_factory=DrawnFrame)
    seconds: float = 5.0
    """Approximate time in seconds spent on each renderer."""


@dataclass(frozen=True)
class Measured:
    """A renderer's median time per image in milliseconds, and its image (H, W, 3) in [0, 1]."""

    ms: float
    picture: NDArray[np.float32]


def main(arguments: Arguments) -> int:
    context = offscreen_context()
    frame, manifest, seen = arguments.drawn.open(is_ordered=False)
    print(f"{driver_name(context)}; {frame.point_count:,} points, {seen.width} x {seen.height}\n")
    exact = {layers: _float_picture(frame, manifest, seen, layers) for layers in LAYERS}
    _print_renderers(context, RenderRequest(frame, seen, manifest, DisplaySettings(12)), exact[12], arguments.seconds)
    _print_precisions(context, RenderRequest(frame, seen, manifest, DisplaySettings(12)), exact[15], arguments.seconds)
    return 0


def _print_renderers(
    context: moderngl.Context, request: RenderRequest, exact: NDArray[np.float32], seconds: float
) -> None:
    titles = ["renderer, K = 12", "ms", "fps", "speed relative to peel", "mean difference"]
    print(tables.head([*titles, "pixels that differ by more than 0.02", "PSNR dB"]))
    found = {name: _measured(context, make_renderer(name, context), request, seconds) for name in RENDERERS}
    for name, one in found.items():
        difference = np.abs(one.picture - exact)
        off = 100 * float((difference.max(axis=2) > 0.02).mean())
        cells = [f"{one.ms:.1f}", f"{1e3 / one.ms:.1f}", f"{found['peel'].ms / one.ms:.1f} x"]
        errors = [f"{difference.mean():.1e}", f"{off:.3f}%", f"{_psnr(one.picture, exact):.1f}"]
        print(tables.row([name, *cells, *errors]))
    print()


def _print_precisions(
    context: moderngl.Context, request: RenderRequest, exact: NDArray[np.float32], seconds: float
) -> None:
    names: tuple[RendererName, ...] = ("peel", "dual")
    columns = [(name, precision) for name in names for precision in ("float32", "float16")] + [("cpu", "float16")]
    titles = [title for name, precision in columns for title in (f"{name}, {precision}: fps", "PSNR dB")]
    print(tables.head(["K", *titles]))
    for layers in LAYERS:
        cells = []
        for name, precision in columns:
            renderer = make_renderer(name, context, precision)
            one = _measured(context, renderer, replace(request, settings=DisplaySettings(layers)), seconds)
            cells += [f"{1e3 / one.ms:.2f}", f"{_psnr(one.picture, exact):.1f}"]
        print(tables.row([layers, *cells]))
    print()


def _measured(context: moderngl.Context, renderer: Renderer, request: RenderRequest, seconds: float) -> Measured:
    """Measure the time to draw images from slightly different cameras. Return the median time, and the image from the
    request's camera."""
    canvas = Canvas(context)
    times: list[float] = []
    end = time.perf_counter() + seconds
    while len(times) < 4 or (time.perf_counter() < end and len(times) < 500):
        turned = replace(request, camera=_turned(request.camera, TURN * (1 + len(times) % 50)))
        started = time.perf_counter()
        renderer.draw(turned, canvas, wait=True)
        context.finish()
        times.append(1e3 * (time.perf_counter() - started))
    renderer.draw(request, canvas, wait=True)
    picture = canvas.read_rgb8().astype(np.float32) / 255
    renderer.release()
    canvas.release()
    return Measured(statistics.median(times[1:]), picture)


def _turned(seen: Camera, angle: float) -> Camera:
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    return replace(seen, rotation=turn @ seen.rotation, translation=turn @ seen.translation)


def _float_picture(frame: BakedFrame, manifest: SceneManifest, seen: Camera, layers: int) -> NDArray[np.float32]:
    """Render the frame on the CPU in float32, as the reference for the errors."""
    colours = shade_reference(frame, seen, manifest)
    sizes: list[Any] = [frame.radius.astype(np.float32), frame.density.astype(np.float32)]
    rgb, _, _ = render_points_numpy(frame.xyz, colours, *sizes, seen, layers=layers, near=manifest.near)
    return np.clip(rgb, 0, 1)


def _psnr(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    return float(-10 * np.log10(np.square(one - other).mean() + 1e-12))


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Arguments, description=__doc__)))
