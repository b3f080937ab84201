"""Generation of a capture as a rig records it: the recorded images or videos, the disturbed calibration and the
truth."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.recording.capture.calibration import write_calibration
from fourd.recording.capture.focus import median_distance, viewing_centre
from fourd.recording.capture.frame_rate import NAME as RATE_NAME
from fourd.recording.capture.frame_rate import write_rate
from fourd.recording.capture.layout import EXTRINSICS_NAME, INTRINSICS_NAME, VIDEOS, frame_name
from fourd.recording.synth.folder import (
    has_finished,
    prepare_folder,
    read_settings,
    write_cameras,
    write_image,
    write_settings,
)
from fourd.recording.synth.generate import SynthSettings, make_synthetic
from fourd.recording.synth.rig.calibration import disturb
from fourd.recording.synth.rig.camera import RigCamera, draw_camera, expose, record
from fourd.recording.synth.rig.people import Walker, draw_walkers, make_stage, render_walkers
from fourd.recording.synth.rig.settings import RigSettings
from fourd.recording.synth.rig.shutter import row_weights
from fourd.recording.synth.rig.sources import Moment, Source, captured_source, rendered_source
from fourd.recording.synth.rig.video import check_video, write_video

RIG_NAME = "rig.json"
CLEAN = Path("truth", "clean")
"""Folder of the clean capture in the recorded one."""
COPIED = ("images", "masks", "bgs", VIDEOS, INTRINSICS_NAME, EXTRINSICS_NAME, RATE_NAME, "videos.json", "split.json")
PEOPLE_STREAM = 27


def make_rig_capture(out: Path, clean: SynthSettings | Path, settings: RigSettings) -> None:
    """Write a clean capture as a rig would have recorded it into the folder ``out``.

    The capture contains videos/CAM.mp4 or images/CAM/FRAME.png, and a calibration with errors. The truth is in
    truth/: the true calibration, masks/CAM/FRAME.png (mattes of the recorded images), rig.json (what was drawn for each
    camera) and the clean capture in clean/. The same settings give the same files.

    Args:
        out: folder that does not exist, is empty, or contains a synthetic capture, which is replaced.
        clean: settings of the synthetic capture to record, or the folder of a clean capture.
        settings: strengths of the factors.

    Raises:
        UserError: if the clean capture is not valid, or does not suit the factors.
    """
    stored = stored_settings(clean, settings)
    if has_finished(out, stored):
        return
    source = rendered_source(clean) if isinstance(clean, SynthSettings) else captured_source(clean)
    _check(source, clean, settings)
    prepare_folder(out)
    write_settings(out, stored, finished=False)
    if isinstance(clean, SynthSettings):
        make_synthetic(out / CLEAN, **asdict(clean))
    else:
        _copy_capture(clean, out / CLEAN)
        source = captured_source(out / CLEAN)
        if (clean / "split.json").exists():
            shutil.copyfile(clean / "split.json", out / "split.json")
    rig = _write_rig(out, source, settings)
    walkers = _draw_walkers(source, settings)
    write_cameras(
        source.names,
        source.frames,
        lambda index, advance: _write_camera(out, source, index, rig[index], walkers, settings, advance),
    )
    write_settings(out, stored, finished=True)


def stored_settings(clean: SynthSettings | Path, settings: RigSettings) -> dict[str, object]:
    """Return the content of synth.json, which changes if a file of the clean capture changes.

    Raises:
        UserError: if ``clean`` is not the folder of a clean capture.
    """
    if isinstance(clean, SynthSettings):
        return {"rig": True, **asdict(settings), "clean": asdict(clean)}
    if not clean.is_dir():
        got = "a file" if clean.exists() else "no such folder"
        raise UserError(f"--from: {clean}: expected a capture's folder, got {got}; check the path")
    old = read_settings(clean)
    if old is not None and "rig" in old:
        raise UserError(
            f"--from: {clean}: expected a clean capture, got one that fourd synth --rig wrote; name {clean / CLEAN}"
        )
    content = hashlib.sha256()
    for path in _files(clean):
        content.update(f"{path.relative_to(clean).as_posix()}\0".encode("utf-8", "surrogateescape"))
        content.update(hashlib.sha256(path.read_bytes()).digest())
    return {"rig": True, **asdict(settings), "clean": {"capture": clean.resolve().name, "sha256": content.hexdigest()}}


def _files(capture: Path) -> Iterator[Path]:
    """Yield the files of a capture that are copied."""
    for name in COPIED:
        path = capture / name
        files = sorted(path.rglob("*")) if path.is_dir() else [path]
        yield from (file for file in files if file.is_file())


def _copy_capture(capture: Path, target: Path) -> None:
    for path in _files(capture):
        copy = target / path.relative_to(capture)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, copy)


def _check(source: Source, clean: SynthSettings | Path, settings: RigSettings) -> None:
    if settings.people and not source.has_mattes:
        raise UserError(
            f"--rig: people: expected a capture with masks, because people walk behind the subject, got none in "
            f"{clean}; write people=0"
        )
    if settings.video:
        for camera in source.cameras:
            check_video(settings.codec, camera.width, camera.height)


def _write_rig(out: Path, source: Source, settings: RigSettings) -> list[RigCamera]:
    """Draw the cameras, and write their calibrations, true and disturbed, and what was drawn."""
    distance = median_distance(source.cameras, viewing_centre(source.cameras))
    rig = [draw_camera(settings, index, distance) for index in range(len(source.names))]
    disturbed = [disturb(camera, drawn.error) for camera, drawn in zip(source.cameras, rig, strict=True)]
    write_calibration(out, source.names, disturbed, source.metres_per_unit)
    write_calibration(out / "truth", source.names, source.cameras, source.metres_per_unit)
    rows = {name: drawn.stored(float(source.rate)) for name, drawn in zip(source.names, rig, strict=True)}
    content = {"version": 1, "settings": asdict(settings), "cameras": rows}
    write_text_atomically(out / "truth" / RIG_NAME, json.dumps(content, indent=1) + "\n")
    if not settings.video:
        write_rate(out, source.rate)
    return rig


def _draw_walkers(source: Source, settings: RigSettings) -> list[Walker]:
    rng = np.random.default_rng([settings.seed, PEOPLE_STREAM])
    return draw_walkers(int(settings.people), source.cameras, make_stage(source.cameras), rng)


def _write_camera(
    out: Path,
    source: Source,
    index: int,
    camera: RigCamera,
    walkers: Sequence[Walker],
    settings: RigSettings,
    advance: Callable[[], None],
) -> None:
    """Write all frames of one camera."""
    name, true = source.names[index], source.cameras[index]
    pictures = _record_frames(out, source, index, camera, walkers, advance)
    if settings.video:
        write_video(out / VIDEOS / f"{name}.mp4", pictures, (true.width, true.height), source.rate, settings)
        return
    for frame, picture in enumerate(pictures):
        write_image(out / "images" / name / f"{frame_name(frame)}.png", picture[..., ::-1])


def _record_frames(
    out: Path, source: Source, index: int, camera: RigCamera, walkers: Sequence[Walker], advance: Callable[[], None]
) -> Iterator[NDArray[np.uint8]]:
    """Yield the recorded images of one camera, and write their true mattes."""
    view = source.open_view(index)
    on_stage = make_stage(source.cameras).camera(source.cameras[index])

    # Successive frames of a given capture share knots.
    @lru_cache(maxsize=4)
    def moment(knot: int) -> Moment:
        seconds = knot / source.knots_per_frame / float(source.rate)
        return view(knot, render_walkers(walkers, on_stage, seconds) if walkers else None)

    for frame in range(source.frames):
        weights = row_weights(camera.shutter, frame, on_stage.height, source.knots_per_frame)
        picture, matte = record(camera, expose(weights, moment), frame)
        if matte is not None:
            write_image(out / "truth" / "masks" / source.names[index] / f"{frame_name(frame)}.png", matte)
        yield picture
        advance()
