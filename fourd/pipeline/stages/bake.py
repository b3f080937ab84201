"""Baking: converts a trained run to a .4dv scene."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from fourd.base.files import atomic_path, remove_unfinished_file
from fourd.pipeline.stage import Artefact, Context, Stage
from fourd.reconstruction.training.segments.segmented_run import open_trained
from fourd.recording.capture.frame_rate import NAME
from fourd.scene.bake import bake_run
from fourd.scene.packing.report import PackSettings, pack_and_report
from fourd.scene.scene import BAKED_LAYERS


@dataclass(frozen=True)
class BakeFiles:
    """The folder of the run, and the path of the scene file to be written."""

    run: Path
    scene: Path


@dataclass(frozen=True)
class BakeSettings:
    """Number of points composited per pixel, playback rate in frames per second, and settings for packing
    (compressing) the scene.

    If ``fps`` is None, the scene gets the capture's frame rate. If ``pack`` is None, the scene is not packed.
    """

    layers: int = BAKED_LAYERS
    fps: float | None = None
    pack: PackSettings | None = None


def bake_stage(
    files: BakeFiles, settings: BakeSettings, capture: Path | None = None, after: tuple[str, ...] = ("train",)
) -> Stage[BakeFiles, BakeSettings]:
    """Create the stage that bakes the newest checkpoint of a run, or of each segment of a run.

    The stage runs again if the frame rate that is stored in ``capture`` changes. ``after`` contains the names of the
    stages that train the run.
    """
    inputs = () if capture is None else (Artefact(capture / NAME),)
    return Stage("bake", run_bake, files, settings, inputs=inputs, outputs=(files.scene,), after=after)


def run_bake(files: BakeFiles, settings: BakeSettings, context: Context) -> None:
    """Load the newest checkpoints and write every frame to the scene file."""
    remove_unfinished_file(files.scene)
    with closing(open_trained(files.run)) as trained:
        if settings.pack is None:
            bake_run(trained, files.scene, context.console, settings.layers, settings.fps)
            return
        with atomic_path(files.scene) as unpacked:
            bake_run(trained, unpacked, context.console, settings.layers, settings.fps)
            pack_and_report(unpacked, unpacked, settings.pack, context.console, files.scene)
