"""Play a scene or a run in a window, or write a video or a picture of it without one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from fourd.cli.options import check_rendering, describe, option
from fourd.errors import UserError
from fourd.viewer.display import DisplaySettings
from fourd.viewer.rendering.renderers import RendererName


@dataclass(frozen=True)
class Arguments:
    """Opens a window, whose panel lists the controls, unless --headless or --screenshot is given."""

    source: tyro.conf.Positional[Annotated[Path | None, option("[SOURCE]", "none")]] = None
    """A .4dv file, or a run's folder, which is reloaded while it trains. Files dropped on the window open too."""
    renderer: Annotated[
        Literal["auto"] | RendererName,
        describe(
            "sorted: one pass over points sorted by depth, for GPUs. peel, dual: depth peeling, exact and slow.",
            "cpu: exact, needs no GPU. auto: sorted on a GPU, else cpu; the choice and its reason are printed.",
        ),
    ] = "auto"
    size: Annotated[tuple[int, int] | None, option("W H", "1280 720; for --screenshot the camera's")] = None
    """Width and height in pixels, of the window or the pictures."""
    layers: Annotated[int | None, option("INT", "the scene's")] = None
    """Points composited per pixel (K), 1 to 64. The renderer sorted composites all points."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Red, green and blue of the backdrop, 0 to 1 each."""
    headless: Annotated[Path | None, option("FILE.mp4", "none")] = None
    """Write this video without a window."""
    path: str = "orbit"
    """Camera path of --headless: orbit, spiral, cameras, or a JSON file that the window recorded."""
    steps: Annotated[int | None, option("INT", "120, or the number of frames if larger")] = None
    """Number of pictures of --headless. Each advances the scene by a frame; the scene loops."""
    fps: Annotated[float | None, option("FLOAT", "the scene's")] = None
    """Frames per second of --headless."""
    screenshot: Annotated[Path | None, option("FILE.png", "none")] = None
    """Write this picture without a window."""
    camera: Annotated[str | None, option("NAME", "the first")] = None
    """Capture camera of --screenshot."""
    frame: int = 0
    """Frame of --screenshot, from 0."""


def run(arguments: Arguments) -> None:
    """Open a window, or write a video or a picture."""
    console = Console(stderr=True)
    check_rendering(
        arguments.layers, arguments.background, size=arguments.size, steps=arguments.steps, fps=arguments.fps
    )
    settings = DisplaySettings(layers=arguments.layers or 0, background=arguments.background)
    if arguments.headless is None and arguments.screenshot is None:
        from fourd.viewer.app import run_viewer

        run_viewer(arguments.source, arguments.renderer, arguments.size or (1280, 720), settings, console)
        return
    from fourd.viewer.headless import Headless

    if arguments.source is None:
        raise UserError("SOURCE: expected a .4dv file or a run's folder, got none; give one")
    headless = Headless(arguments.source, arguments.renderer, arguments.size, settings)
    if arguments.screenshot is not None:
        headless.screenshot(arguments.screenshot, arguments.camera, arguments.frame, console)
        console.print(f"{arguments.screenshot}: written", soft_wrap=True)
    if arguments.headless is not None:
        count = headless.video(arguments.headless, arguments.path, arguments.steps, arguments.fps, console)
        console.print(f"{arguments.headless}: {count} pictures", soft_wrap=True)
