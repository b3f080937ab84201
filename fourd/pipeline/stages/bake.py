"""Baking: converts a trained run to a .4dv scene."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from fourd.base.files import atomic_path, remove_unfinished_file
from fourd.pipeline.stage import Artefact, Context, Stage
from fourd.reconstruction.training.run import TrainedRun
from fourd.reconstruction.training.segments.segmented_run import SegmentedRun, open_trained
from fourd.recording.capture.frame_rate import NAME
from fourd.recording.importing.record import sound_choice
from fourd.recording.soundtrack.captures import NAME as SOUND_FILE
from fourd.recording.soundtrack.choice import AUTO, NONE
from fourd.recording.soundtrack.clips import clip_sound
from fourd.scene.bake import bake_run
from fourd.scene.files.sound import OpusSound
from fourd.scene.packing.report import PackSettings, pack_and_report
from fourd.scene.scene import BAKED_LAYERS


@dataclass(frozen=True)
class BakeFiles:
    """The folder of the run, and the path of the scene file to be written."""

    run: Path
    scene: Path


@dataclass(frozen=True)
class BakeSettings:
    """Number of points composited per pixel, playback rate in frames per second, settings for packing (compressing) the
    scene, and its sound, which is the value of --sound (:func:`~fourd.recording.soundtrack.choice.choose_sound`).

    If ``fps`` is None, the scene gets the capture's frame rate. If ``pack`` is None, the scene is not packed.
    """

    layers: int = BAKED_LAYERS
    fps: float | None = None
    pack: PackSettings | None = None
    sound: str = AUTO


def bake_stage(
    files: BakeFiles, settings: BakeSettings, capture: Path | None = None, after: tuple[str, ...] = ("train",)
) -> Stage[BakeFiles, BakeSettings]:
    """Create the stage that bakes the newest checkpoint of a run, or of each segment of a run.

    The stage runs again if the frame rate or the sound that is stored in ``capture`` changes. ``after`` contains the
    names of the stages that train the run.
    """
    inputs = () if capture is None else (Artefact(capture / NAME), Artefact(capture / SOUND_FILE))
    if Path(settings.sound).is_file():
        inputs = (*inputs, Artefact(Path(settings.sound)))
    return Stage("bake", run_bake, files, settings, inputs=inputs, outputs=(files.scene,), after=after)


def run_bake(files: BakeFiles, settings: BakeSettings, context: Context) -> None:
    """Load the newest checkpoints and write every frame to the scene file."""
    remove_unfinished_file(files.scene)
    with closing(open_trained(files.run)) as trained:
        sound = _sound(trained, settings, context)
        if settings.pack is None:
            bake_run(trained, files.scene, context.console, settings.layers, settings.fps, sound=sound)
            return
        with atomic_path(files.scene) as unpacked:
            bake_run(trained, unpacked, context.console, settings.layers, settings.fps, sound=sound)
            pack_and_report(unpacked, unpacked, settings.pack, context.console, files.scene)


def _sound(trained: TrainedRun | SegmentedRun, settings: BakeSettings, context: Context) -> OpusSound | None:
    """Return the sound of the frames of a run."""
    capture = trained.run.capture
    chosen = sound_choice(capture.path) if settings.sound == AUTO else settings.sound
    content = clip_sound(capture, settings.sound, settings.fps, context.log, context.track, uses_videos=chosen != NONE)
    return None if content is None else OpusSound(content)
