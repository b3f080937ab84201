"""From videos or a capture to a 4D scene with one command: import, check, matte, carve, train, export."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console

from fourd.cli.captures.matte import processes
from fourd.cli.runs import train
from fourd.matting.stage import MatteSettings
from fourd.pipeline.make import make_scene
from fourd.pipeline.stage import Context
from fourd.training.losses.lpips import load_lpips

DEFAULT_SECONDS = 1800.0


@dataclass(frozen=True)
class Arguments:
    """Every stage is cached: run the same command again after a stop, and it goes on."""

    capture: tyro.conf.Positional[Path]
    """A capture, or anything that fourd import reads, such as a folder of videos and their calibration."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The scene file to write; its stages' results lie beside it in OUT.work/."""
    scene: Literal["object", "full"] | None = None
    """object: what the mattes hold, on black; full: everything, with a static background beside it."""
    config: Path | None = None
    """YAML file laid over the defaults."""
    test_views: str | None = None
    """Names of held-out cameras, with commas."""
    views: str | None = None
    """Names of the cameras to use, with commas; all when not given."""
    frames: str | None = None
    """Frames as A:B or A:B:S, B not included; all when not given."""
    scale: float | None = None
    """Scale of the images; 0.5 halves both sides."""
    points: int | None = None
    """Points of each frame."""
    background: str | None = None
    """How the points of a full scene's background are found in clean plates: ngp, a radiance field that stereo helps;
    sfm, stereo alone; or a PLY with your own points, in world units."""
    background_points: int | None = None
    """Points of a full scene's background."""
    refine_cameras: bool = False
    """Correct the calibration: poses and focal lengths, before carving and while training."""
    refine_colours: bool = False
    """Learn an affine correction of each camera's colours."""
    max_seconds: float | None = None
    """Seconds of training; 1800 when neither this, --max-steps nor the config file says."""
    max_steps: int | None = None
    """Steps of training."""
    seed: int | None = None
    """Seed of everything random."""
    method: Literal["motion", "chroma", "rvm"] = "motion"
    """How mattes are made where there are none: see fourd matte --help."""
    screen: str | None = None
    """The screen's colour as R,G,B of 0 to 255, for --method chroma."""
    rvm: Path | None = None
    """TorchScript file of Robust Video Matting, for --method rvm."""
    workers: int | None = None
    """Processes that make mattes and carve; as many as there are cores when not given."""
    lpips_weights: Path | None = None
    """File or folder with the weights of VGG-16 and LPIPS; the usual caches when not given."""


def run(arguments: Arguments) -> None:
    """Run every stage that is not done."""
    console = Console()  # stderr is kept for the one line that tells of wrong input
    known = {field.name for field in fields(train.Arguments)}
    given: dict[str, Any] = {
        field.name: getattr(arguments, field.name) for field in fields(arguments) if field.name in known
    }
    config = train.overlaid(train.Arguments(**given), DEFAULT_SECONDS)
    load_lpips(arguments.lpips_weights)
    mattes = MatteSettings(arguments.method, config.seed, arguments.screen, arguments.rvm)
    context = Context(console, processes(arguments.workers))
    make_scene(arguments.capture, arguments.out, config, mattes, context, lpips_weights=arguments.lpips_weights)
    console.print(
        f"{arguments.out}: written; next: fourd render {arguments.out} --path orbit --out orbit.mp4", soft_wrap=True
    )
