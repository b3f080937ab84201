"""Open a scene or a run and walk around in it; or, without a window, make a video or a picture of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro
from rich.console import Console

from fourd.errors import UserError
from fourd.viewer.display import DisplaySettings
from fourd.viewer.rendering.renderers import RendererName


@dataclass(frozen=True)
class Arguments:
    """Without --headless or --screenshot a window opens; its panel tells the controls."""

    source: tyro.conf.Positional[Path | None] = None
    """A .4dv file, or a run's folder, which is shown while it trains. The window also opens what is dropped on it."""
    renderer: Literal["auto"] | RendererName = "auto"
    """sorted: one pass over points sorted by depth, for GPUs. peel and dual: depth peeling, exact and slow. cpu: exact,
    needs no GPU. auto: sorted on a GPU, cpu elsewhere; it says which and why."""
    size: tuple[int, int] | None = None
    """Width and height in pixels, of the window or the pictures. 1280 720, or a screenshot's camera, when not given."""
    layers: int | None = None
    """Points composited a pixel (K), 1 to 64; the scene's when not given. sorted composites all."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Red, green and blue behind the object, from 0 to 1."""
    headless: Path | None = None
    """Write this MP4 without a window."""
    path: str = "orbit"
    """Of --headless: orbit, spiral, cameras, or a camera path that the window recorded (a JSON file)."""
    steps: int | None = None
    """Pictures along the path of --headless; the scene plays in a loop meanwhile. 120 or all frames when not given."""
    fps: float | None = None
    """Frames a second of --headless; the scene's when not given."""
    screenshot: Path | None = None
    """Write this PNG without a window."""
    camera: str | None = None
    """Of --screenshot: the name of a capture camera; the first when not given."""
    frame: int = 0
    """Of --screenshot: a frame, from 0."""


def run(arguments: Arguments) -> None:
    """Open a window, or write a video or a picture."""
    console = Console(stderr=True)
    _check(arguments)
    settings = DisplaySettings(layers=arguments.layers or 0, background=arguments.background)
    if arguments.headless is None and arguments.screenshot is None:
        from fourd.viewer.app import run_viewer

        run_viewer(arguments.source, arguments.renderer, arguments.size or (1280, 720), settings, console)
        return
    from fourd.viewer.headless import Headless

    if arguments.source is None:
        raise UserError("SOURCE: expected a .4dv file or a run's folder, got none; name one")
    headless = Headless(arguments.source, arguments.renderer, arguments.size, settings)
    if arguments.screenshot is not None:
        headless.screenshot(arguments.screenshot, arguments.camera, arguments.frame, console)
        console.print(f"{arguments.screenshot}: written", soft_wrap=True)
    if arguments.headless is not None:
        count = headless.video(arguments.headless, arguments.path, arguments.steps, arguments.fps, console)
        console.print(f"{arguments.headless}: {count} pictures", soft_wrap=True)


def _check(arguments: Arguments) -> None:
    if arguments.layers is not None and not 1 <= arguments.layers <= 64:
        raise UserError(f"--layers: expected 1 to 64, got {arguments.layers}")
    if any(not 0 <= value <= 1 for value in arguments.background):
        raise UserError(f"--background: expected three numbers from 0 to 1, got {arguments.background}")
    if arguments.size is not None and not all(16 <= side <= 16384 for side in arguments.size):
        raise UserError(f"--size: expected 16 to 16384 pixels, got {arguments.size[0]} x {arguments.size[1]}")
    if arguments.steps is not None and arguments.steps < 1:
        raise UserError(f"--steps: expected at least 1, got {arguments.steps}")
    if arguments.fps is not None and not 0 < arguments.fps <= 1000:
        raise UserError(f"--fps: expected more than 0 and at most 1000, got {arguments.fps:g}")
