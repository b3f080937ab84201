"""Play a scene or a run in a window, or render a video or an image without opening a window."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console

from fourd.base.errors import UserError
from fourd.base.files import require_suffix
from fourd.base.progress import Terminal
from fourd.base.storage import Location, local_copy
from fourd.cli.locations import PATH_OR_URL, transfer_progress
from fourd.cli.options import StyleName, check_rendering, describe, option
from fourd.cli.outputs import READS, WRITES
from fourd.cli.scenes.description.values import count_text
from fourd.viewer.rendering.renderer_name import RendererName

if TYPE_CHECKING:
    from fourd.viewer.display import DisplaySettings


@dataclass(frozen=True)
class Arguments:
    """Opens a window unless --headless or --screenshot is given. A panel in the window lists the controls."""

    source: tyro.conf.Positional[Annotated[Location | None, READS, PATH_OR_URL, option("[SCENE|RUN]", "none")]] = None
    """A .4dv file, its URL such as s3://bucket/scene.4dv, or a run folder. A run is reloaded while it trains. You can
    also drop a file on the window."""
    renderer: Annotated[
        Literal["auto"] | RendererName,
        describe(
            "sorted: one pass over points sorted by depth, for GPUs. peel: depth peeling, exact and slow.",
            "dual: dual depth peeling, exact and slow. cpu: exact rendering without a GPU.",
            "auto: sorted if there is a GPU, otherwise cpu. The selected renderer and the reason are printed.",
        ),
    ] = "auto"
    size: Annotated[tuple[int, int] | None, option("W H", "1280 720; the camera's size for --screenshot")] = None
    """Width and height of the window, the video or the image in pixels."""
    layers: Annotated[int | None, option("INT", "the scene's")] = None
    """Number of points composited per pixel (K), 1 to 64. Ignored by --renderer sorted, which composites all points."""
    background: Annotated[
        tuple[float, float, float] | None, option("R G B", "the paper of the style, or else dark grey")
    ] = None
    """Background colour: red, green and blue, 0 to 1 each."""
    transparent: bool = False
    """Write the --screenshot with an alpha channel instead of a background."""
    style: StyleName = None
    capture: Annotated[
        Path | None, READS, option("FOLDER", "the run's, or that of the work folder beside the scene")
    ] = None
    """Capture whose pictures the window compares with the scene (key V)."""
    beside: Annotated[Path | None, READS, option("SCENE|RUN", "none")] = None
    """Another scene, which the window shows beside the scene, from the same view and in step with it."""
    headless: Annotated[Path | None, WRITES, option("FILE.{mp4,webm,gif}", "none")] = None
    """Render a video to this .mp4 (H.264), .webm (VP9) or .gif file, without opening a window."""
    path: Annotated[str, tyro.conf.arg(metavar="{orbit,spiral,cameras,FILE.json}")] = "orbit"
    """Camera path of the --headless video. FILE.json is any path file that fourd render takes."""
    steps: Annotated[int | None, option("INT", "120, or the number of frames if that is larger")] = None
    """Number of images in the --headless video. The scene advances by one frame per image and plays in a loop."""
    fps: Annotated[float | None, option("FLOAT", "the scene's")] = None
    """Frames per second of the --headless video."""
    screenshot: Annotated[Path | None, WRITES, option("FILE.png", "none")] = None
    """Render an image to this file, without opening a window."""
    camera: Annotated[str | None, option("NAME", "the first camera")] = None
    """Name of the capture camera from which the --screenshot image is rendered."""
    frame: int = 0
    """Index of the scene's frame that the --screenshot image shows, from 0."""


def run(arguments: Arguments) -> None:
    """Open a window, or write a video or an image."""
    from fourd.scene.styles import load_style
    from fourd.viewer.display import DEFAULT_BACKGROUND, DisplaySettings

    console = Terminal(stderr=True)
    check_rendering(
        arguments.layers,
        arguments.background or DEFAULT_BACKGROUND,
        size=arguments.size,
        steps=arguments.steps,
        fps=arguments.fps,
    )
    if arguments.transparent and (arguments.screenshot is None or arguments.headless is not None):
        raise UserError("--transparent: expected --screenshot FILE.png alone, got another output; videos have no alpha")
    _check_comparison(arguments)
    style = None if arguments.style is None else load_style(arguments.style)
    settings = DisplaySettings(layers=arguments.layers or 0, background=DEFAULT_BACKGROUND, style=style)
    if arguments.background is not None:
        settings = settings.with_background(arguments.background)
    with nullcontext() if arguments.source is None else local_copy(arguments.source, transfer_progress()) as source:
        _view(arguments, source, settings, console)


def _check_comparison(arguments: Arguments) -> None:
    """Raise UserError if there is nothing to compare with, or no window for the comparison."""
    has_window = arguments.headless is None and arguments.screenshot is None
    for name, path in (("--capture", arguments.capture), ("--beside", arguments.beside)):
        if path is not None and not has_window:
            raise UserError(f"{name}: expected a window to compare in, got --headless or --screenshot; omit {name}")
        if path is not None and not path.exists():
            raise UserError(f"{name} {path}: expected a file or a folder, got nothing there; check the path")
    if arguments.beside is not None and arguments.source is None:
        raise UserError("--beside: expected a scene to compare with, got none; name it first")
    if arguments.capture is not None:
        from fourd.viewer.comparison.captured import require_capture

        require_capture(arguments.capture)


def _view(arguments: Arguments, source: Path | None, settings: DisplaySettings, console: Console) -> None:
    if arguments.headless is None and arguments.screenshot is None:
        from fourd.viewer.app import run_viewer

        size = arguments.size or (1280, 720)
        run_viewer(
            source, arguments.renderer, size, settings, console, arguments.style, arguments.capture, arguments.beside
        )
        return
    from fourd.viewer.headless import Headless
    from fourd.viewer.output.video import require_video

    if arguments.headless is not None:
        require_video(arguments.headless, arguments.fps)
    if arguments.screenshot is not None:
        require_suffix(arguments.screenshot, (".png",), "an image")
    if source is None:
        raise UserError("SCENE|RUN: expected a .4dv file or a run folder, got none; name a file or folder")
    headless = Headless(source, arguments.renderer, arguments.size, settings)
    if arguments.screenshot is not None:
        headless.screenshot(
            arguments.screenshot, arguments.camera, arguments.frame, console, is_transparent=arguments.transparent
        )
        console.print(f"{arguments.screenshot}: written", soft_wrap=True)
    if arguments.headless is not None:
        count = headless.video(arguments.headless, arguments.path, arguments.steps, arguments.fps, console)
        console.print(f"{arguments.headless}: {count_text(count, 'image')}", soft_wrap=True)
