"""Train a 4D scene on a calibrated capture with mattes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console

from fourd.configs import load_overlay
from fourd.errors import UserError
from fourd.parallel import core_count
from fourd.pipeline.graph import RunRequest, stages_to_run
from fourd.pipeline.make import require_new_run
from fourd.pipeline.runner import AnyStage, Runner
from fourd.pipeline.stage import Context
from fourd.pipeline.stages.train import TrainFiles, train_stage
from fourd.training.config import TrainConfig
from fourd.training.losses.lpips import load_lpips
from fourd.training.run import open_run

WAYS = ("ngp", "sfm")
"""Of finding a background's points, as ``--background`` takes them."""


@dataclass(frozen=True)
class Arguments:
    """Flags override the config file, which overrides the defaults."""

    capture: tyro.conf.Positional[Path]
    """Folder with images/, masks/, intri.yml and extri.yml."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The run's folder: made new, or gone on with by --resume."""
    scene: Literal["object", "full"] | None = None
    """object: what the mattes hold, on black; full: everything, with a static background beside it."""
    config: Path | None = None
    """YAML file laid over the defaults; docs/configuration.md lists its keys."""
    test_views: str | None = None
    """Names of held-out cameras, with commas: 05,11."""
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
    points_from: Path | None = None
    """Folder with your own FRAME.ply (six digits) of each frame, in world units, in place of carving."""
    max_seconds: float | None = None
    """Stop after this many seconds of training (carving before it is not counted)."""
    max_steps: int | None = None
    """Stop after this many steps."""
    seed: int | None = None
    """Seed of everything random."""
    resume: bool = False
    """Go on from the newest checkpoint; only the budget may be changed."""
    lpips_weights: Path | None = None
    """File or folder with the weights of VGG-16 and LPIPS; the usual caches when not given."""


def run(arguments: Arguments) -> None:
    """Run every stage that leads to the run, and train it."""
    console = Console()  # stderr is kept for the one line that reports wrong input
    context = Context(console, core_count())
    load_lpips(arguments.lpips_weights)  # wrong weights are reported before any work
    if arguments.resume:
        train = open_run(arguments.out).config.train
        if arguments.max_steps is not None or arguments.max_seconds is not None:
            train = replace(train, max_steps=arguments.max_steps, max_seconds=arguments.max_seconds)
        files = TrainFiles(arguments.capture, arguments.out, arguments.lpips_weights)
        stages: tuple[AnyStage, ...] = (train_stage(files, train),)
    else:
        train = overlaid(arguments)
        require_new_run(arguments.out)
        stages = stages_to_run(
            RunRequest(arguments.capture, arguments.out, train, arguments.points_from, arguments.lpips_weights)
        )
    Runner(context).run(stages)
    console.print(f"{arguments.out}: trained; next: fourd eval {arguments.out}", soft_wrap=True)


def overlaid(arguments: Arguments, seconds: float | None = None) -> TrainConfig:
    """Defaults, then the config file, then the flags that were given; ``seconds`` where none of these ends it."""
    config = TrainConfig() if arguments.config is None else load_overlay(TrainConfig(), arguments.config)
    given: dict[str, Any] = {
        "scene": arguments.scene,
        "test_views": _names(arguments.test_views),
        "views": _names(arguments.views),
        "frames": arguments.frames,
        "image_scale": arguments.scale,
        "points": arguments.points,
        "max_seconds": arguments.max_seconds,
        "max_steps": arguments.max_steps,
        "seed": arguments.seed,
    }
    refined = {
        "poses": arguments.refine_cameras,
        "focal": arguments.refine_cameras,
        "colours": arguments.refine_colours,
    }
    given["refine"] = replace(config.refine, **{name: True for name, wanted in refined.items() if wanted})
    background: dict[str, Any] = {"points": arguments.background_points}
    seeding = _seeding(arguments.background)
    try:
        part = replace(config.background, **_given(background), **seeding)
        config = replace(config, background=part, **_given(given))
    except ValueError as error:
        raise UserError(f"{arguments.config}: {error}" if arguments.config else str(error)) from error
    if config.max_steps is None and config.max_seconds is None and seconds is not None:
        return replace(config, max_seconds=seconds)
    if config.max_steps is None and config.max_seconds is None:
        raise UserError("--max-steps, --max-seconds: expected one of them, got neither; say when to stop")
    return config


def _given(values: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def _seeding(way: str | None) -> dict[str, Any]:
    """What ``--background`` says, as fields of the background's config."""
    if way is None:
        return {}
    if way in WAYS:
        return {"seeding": way, "seeds": None}
    if way.lower().endswith(".ply") or Path(way).is_file():
        return {"seeds": Path(way)}
    raise UserError(f"--background: expected {', '.join(WAYS)} or a PLY file, got '{way}'; see fourd train --help")


def _names(text: str | None) -> tuple[str, ...] | None:
    return None if text is None else tuple(name.strip() for name in text.split(",") if name.strip())
