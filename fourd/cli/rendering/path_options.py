"""The options of `fourd render` for camera paths."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from fourd.base.errors import UserError
from fourd.cli.help import RARE
from fourd.cli.options import option

if TYPE_CHECKING:
    from fourd.base.cameras import Camera
    from fourd.scene.playable import Playable
    from fourd.viewer.camera_paths.plan import PathPlan
    from fourd.viewer.camera_paths.scene import PathScene
    from fourd.viewer.camera_paths.world import World


@dataclass(frozen=True)
class PathOptions:
    """How the scene plays along a --path."""

    freeze: Annotated[int | None, option("FRAME", "the scene plays")] = None
    """Show only this frame, a number of the capture, while the camera moves (bullet time)."""
    speed: float = 1.0
    """Speed of the scene: 0.25 is slow motion. If a path file says which frame each image shows, the camera slows down
    too."""
    ping_pong: Annotated[bool, RARE] = False
    """Play the scene forwards and backwards in turn instead of in a loop, and follow a path file to its end and back.
    """
    path_world: Annotated[str | None, RARE, option("FILE[,FILE]", "the world of the capture")] = None
    """dataparser_transforms.json of a nerfstudio run, for path files from its viewer. If the capture was imported from
    a transforms.json with the key applied_transform, this file is the second one."""


def check_path_options(options: PathOptions, path: str | None) -> None:
    """Raise UserError for an option that is out of range, or that needs --path if there is none."""
    if not 0.001 <= options.speed <= 1000:
        raise UserError(f"--speed: expected 0.001 to 1000, got {options.speed:g}")
    if path is None and options != PathOptions():
        raise UserError("--freeze, --speed, --ping-pong, --path-world: expected --path with them, got none; add --path")


def path_scene(playable: Playable, views: dict[str, Camera]) -> PathScene:
    """Return what a path needs to know of a scene whose cameras are ``views``."""
    from fourd.viewer.camera_paths.scene import PathScene

    return PathScene(
        list(views.values()),
        np.asarray(playable.focus, np.float64),
        len(playable.frame_numbers),
        playable.fps,
        playable.bounds,
        playable.is_whole,
    )


def make_plan(
    path: str,
    options: PathOptions,
    playable: Playable,
    scene: PathScene,
    steps: int | None,
    frames: list[int] | None,
    size: tuple[int, int] | None,
) -> tuple[PathPlan, World]:
    """Return the images along the path, and the relation of its world to that of the capture.

    Args:
        frames: indices of the frames that --frames selects, or None without this option.

    Raises:
        UserError: if an option is not valid, or the file is not a path.
    """
    from fourd.viewer.camera_paths.plan import PathTiming, plan_path
    from fourd.viewer.camera_paths.world import SAME_WORLD, read_world

    frozen = None
    if options.freeze is not None:
        numbers = playable.frame_numbers
        if options.freeze not in numbers:
            raise UserError(f"--freeze: expected a frame from {numbers[0]} to {numbers[-1]}, got {options.freeze}")
        if frames is not None:
            raise UserError("--freeze, --frames: expected one of them, got both; remove one")
        frozen = numbers.index(options.freeze)
    names = [part.strip() for part in (options.path_world or "").split(",") if part.strip()]
    world = SAME_WORLD if options.path_world is None else read_world([Path(name) for name in names])
    timing = PathTiming(steps, options.speed, options.ping_pong, frozen, frames)
    return plan_path(path, scene, timing, size, world=world), world
