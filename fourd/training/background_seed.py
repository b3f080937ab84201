"""The first points of a full scene's background: clean plates of the training views, and what they agree on."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fourd.background.from_stereo import seed_from_stereo
from fourd.background.plate_changes import find_changing_backgrounds
from fourd.background.plates import PlateView, has_plate, read_plates
from fourd.background.radiance.from_radiance import seed_from_radiance
from fourd.background.shell import build_shell, direction_coverage, viewing_centre
from fourd.capture import Capture
from fourd.errors import UserError
from fourd.matting.plates import FOLDER, make_plates
from fourd.matting.selection import Selection
from fourd.ply import ColouredPoints, read_ply, write_ply
from fourd.progress import Log, Track
from fourd.training.config import TrainConfig

BACKGROUND = "background"
POINTS = "points.ply"
PLATES = "plates"
DECIDING = ("points", "seeding", "seeds", "radiance")
"""Keys of the background's config that decide its first points."""


def seed_background(
    capture: Capture, training: list[int], folder: Path, train: TrainConfig, workers: int, track: Track, log: Log
) -> None:
    """Write ``folder/background/points.ply`` from the training views' plates, which are made where there are none.

    Held-out views give neither plates nor points: they must not shape what they judge. What an interrupted call
    left is kept.
    """
    target = folder / BACKGROUND / POINTS
    names = tuple(capture.names[index] for index in training)
    if not all(has_plate(capture.path, name) for name in names):
        make_plates(Selection(capture.path, names, train.frames), "run", workers, track, folder / BACKGROUND / PLATES)
    if target.exists():
        return
    wanted = train.background.points
    if train.background.seeds is not None:
        points = _brought(train.background.seeds, wanted, train.seed)
    else:
        plates = run_plates(capture, training, folder, log)
        _say_what_moves(find_changing_backgrounds(capture, training, plates), log)
        points = _found(plates, train, workers, track, log)
        cameras = [plate.camera for plate in plates]
        shell = build_shell(points, cameras, viewing_centre(cameras))
        share = direction_coverage(points, viewing_centre(cameras), cameras)
        log(
            f"surroundings: the plates show {share:.0%} of the directions about the scene; "
            f"{len(shell.xyz)} points stand for the rest, their colours continued from around"
        )
        points = ColouredPoints(np.concatenate([points.xyz, shell.xyz]), np.concatenate([points.rgb, shell.rgb]))
    write_ply(target, points.xyz, points.rgb)


def _say_what_moves(shares: dict[str, float], log: Log) -> None:
    if shares:
        worst = max(shares, key=lambda name: shares[name])
        others = f" (and {len(shares) - 1} more)" if len(shares) > 1 else ""
        log(
            f"background: up to {shares[worst]:.0%} of what camera '{worst}'{others} sees beside the subject changes "
            "over time; a static background keeps its mean, in which what moves is blurred: let the mattes hold it too"
        )


def _found(plates: tuple[PlateView, ...], train: TrainConfig, workers: int, track: Track, log: Log) -> ColouredPoints:
    """Points of what the plates show, in the way that the config asks for."""
    wanted, seed = train.background.points, train.seed
    if train.background.seeding == "sfm":
        return seed_from_stereo(plates, wanted, seed=seed, workers=workers, log=log, track=track)
    radiance = train.background.radiance
    return seed_from_radiance(plates, wanted, radiance, seed=seed, workers=workers, log=log, track=track)


def run_plates(
    capture: Capture, training: list[int], folder: Path, log: Log = lambda line: None
) -> tuple[PlateView, ...]:
    """The plates of a run's training views: the run's own where it had to make them, else the capture's."""
    made = folder / BACKGROUND / PLATES
    return read_plates(capture, training, log, made=made if made.exists() else capture.path / FOLDER)


def _brought(path: Path, wanted: int, seed: int) -> ColouredPoints:
    """The user's own points; an even draw where there are more than wanted."""
    xyz, rgb = read_ply(path)
    if len(xyz) == 0:
        raise UserError(f"{path}: expected points of the background, got none; bring another PLY")
    kept = np.random.default_rng(seed).permutation(len(xyz))[:wanted]
    return ColouredPoints(xyz[kept], rgb[kept])
