"""Mattes of a whole capture.

The matting models are learned once, then frames are processed in parallel. Interrupted matting can be resumed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError, command_line
from fourd.base.formats.picture import write_picture
from fourd.base.parallel import run_jobs, split_into_blocks
from fourd.base.progress import Track
from fourd.recording.capture import Capture
from fourd.recording.capture.layout import MATTES, parse_frame_range, refuse_symlinks, sample_indices
from fourd.recording.capture.pictures.masks import MaskFolder
from fourd.recording.matting.chroma import ScreenColour, chroma_matte, find_screen, parse_screen
from fourd.recording.matting.mask_files import find_masks, read_mask
from fourd.recording.matting.motion.mattes import matting_cameras, refine_background
from fourd.recording.matting.motion.paint import Paint, read_strokes
from fourd.recording.matting.motion.sampling import learning_frames, passed_frames, reduce_picture, sample_capture
from fourd.recording.matting.motion.saved_model import load_matte_maker, save_subject
from fourd.recording.matting.motion.subject import learn_subject
from fourd.recording.matting.onnx_network import OnnxNetwork, load_onnx
from fourd.recording.matting.output import SHEET, VERSION, MatteOutput, MatteState
from fourd.recording.matting.rvm import RVM, load_rvm
from fourd.recording.matting.selection import Selection
from fourd.recording.matting.solid.moments import reconstruct_moments
from fourd.recording.matting.solid.resting import RestingParts

Picture = NDArray[np.uint8]

INPUTS = ("*.yml", "videos.json", "videos/*", "images/*/*")
SCREEN_FRAMES = 5
FASTEST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


@dataclass(frozen=True)
class MatteSettings:
    """Settings of matting.

    Attributes:
        method: "motion" needs no network. "chroma" needs a screen of one colour. "rvm" and "onnx" need a network file.
            "masks" needs masks of another program.
        seed: random seed for subsampling colours.
        screen: screen colour "R,G,B", each 0 to 255, or None to estimate the colour for each camera.
        rvm: TorchScript file of the Robust Video Matting network.
        onnx: ONNX file of Robust Video Matting or of a segmentation network.
        masks: folder with the masks CAM/FRAME.png of another program, which match the recorded images pixel for
            pixel.
        paint: painted images that correct the mattes of the method "motion".
    """

    method: Literal["motion", "chroma", "rvm", "onnx", "masks"] = "motion"
    seed: int = 0
    screen: str | None = None
    rvm: Path | None = None
    onnx: Path | None = None
    masks: Path | None = None
    paint: tuple[Paint, ...] = ()


def make_mattes(selection: Selection, settings: MatteSettings, workers: int, track: Track) -> int:
    """Write the mattes of a capture's undistorted images as ``.fourd/mattes/CAM/FRAME.png``.

    The models are learned from the whole recording, even if only some frames are selected. Mattes from an earlier call
    with the same inputs and settings are kept, including the mattes of frames that are not selected. If the inputs or
    settings have changed, all mattes are computed again. The old mattes are replaced only when all new mattes are
    written, so they are not lost if the call fails or is interrupted.

    Args:
        selection: the capture. The method "motion" combines the evidence of all selected cameras.
        settings: the matting method and its parameters.
        workers: number of processes.
        track: progress callback.

    Returns:
        The number of frames that this call processed.

    Raises:
        UserError: if no subject moves, the moving regions of the views do not intersect in space, no screen colour is
            found, or the network file is invalid.
    """
    # All frames are opened, because the models are learned from the whole recording, and because the optical flow of a
    # selected frame may need a frame that is not selected. --frames only selects the mattes to write.
    recording = replace(selection, frames=None)
    with recording.open(mattes=False) as capture:
        return _make_missing(capture, recording, selection.frames, settings, workers, track)


def _make_missing(
    capture: Capture, recording: Selection, frames: str | None, settings: MatteSettings, workers: int, track: Track
) -> int:
    """Make the missing mattes for :func:`make_mattes`. ``capture`` is the opened ``recording``."""
    refuse_symlinks(capture.path, capture.path / MATTES)
    # Invalid painted images are reported before the models are learned.
    read_strokes(settings.paint, capture, matting_cameras(capture))
    output = MatteOutput(capture.path, matte_key(capture, settings), matte_key(capture, replace(settings, paint=())))
    output.prepare()
    chosen = parse_frame_range(frames, capture.frame_count)
    lost = output.missing(capture.names, [capture.frame_names[frame] for frame in chosen])
    missing = [chosen[index] for index in lost]
    if missing:
        if settings.method in ("rvm", "onnx"):
            _make_network_mattes(capture, settings, output, missing, track)
        elif settings.method == "masks":
            _convert_masks(capture, settings, output, missing, track)
        else:
            _make_modelled_mattes(capture, recording, settings, output, missing, workers, track)
    output.finish()
    return len(missing)


def _make_modelled_mattes(
    capture: Capture,
    recording: Selection,
    settings: MatteSettings,
    output: MatteOutput,
    missing: Sequence[int],
    workers: int,
    track: Track,
) -> None:
    """Learn the models of the methods "motion" and "chroma", and compute the mattes in parallel."""
    model: Path | tuple[ScreenColour, ...]
    if settings.method == "chroma":
        model = _screen_colours(capture, settings, track)
    else:
        model = output.model
        if not model.exists():
            _learn_subject_model(capture, settings, model, workers, track)
    folder = output.start()
    jobs = [
        _Job(recording, model, folder, tuple(block), settings.paint)
        for block in split_into_blocks(list(missing), workers)
    ]
    for _ in track(run_jobs(_make_frames, jobs, workers), len(missing), "mattes"):
        pass


def matte_key(capture: Capture, settings: MatteSettings) -> str:
    """Hash all inputs of the mattes: settings, selection, and the name, size and modification time of each file."""
    digest = hashlib.sha256(
        json.dumps([VERSION, asdict(settings), capture.names, capture.frame_names], default=str).encode()
    )
    given = [path for path in (settings.rvm, settings.onnx) if path is not None]
    given += [paint.path for paint in settings.paint]
    given += [] if settings.masks is None else sorted(settings.masks.glob("*/*"))
    for line in _versions([*_input_files(capture.path), *given]):
        digest.update(line.encode())
    return digest.hexdigest()


def record_choice(capture: Path, settings: MatteSettings) -> None:
    """Record whether the user chose the settings of the capture's mattes. If so, also record the matting method and a
    hash of the capture's files.

    A user chooses settings through the options of ``fourd matte``. The mattes were made with ``settings``, which count
    as chosen by the user if they differ from the default settings.
    """
    state = MatteState.read(capture)
    is_chosen = settings != MatteSettings()
    chosen = replace(
        state,
        chosen=settings.method if is_chosen else None,
        inputs=_input_hash(capture) if is_chosen else None,
    )
    if chosen != state:
        chosen.write(capture)


def chosen_method(capture: Path) -> str | None:
    """Return the method of the existing mattes, or None if the user did not choose their settings.

    Raises:
        UserError: if the files of the capture have changed since the user chose the settings.
    """
    state = MatteState.read(capture)
    if state.chosen is None or not any((capture / MATTES).glob("*/*")):
        return None
    if state.inputs != _input_hash(capture):
        again = command_line("fourd", "matte", "--method", state.chosen)
        raise UserError(
            f"{capture / MATTES}: expected mattes of the capture's present files, got mattes of earlier files; make "
            f"them again with {again}, or add --method motion to replace them"
        )
    return state.chosen


def forget_choice(capture: Path) -> None:
    """Forget the settings that the user chose for the mattes, so that mattes made with different settings can replace
    the existing mattes.

    The contact sheet of the mattes is removed. It is an output of the matting stage, so its absence makes the stage run
    again.
    """
    state = MatteState.read(capture)
    if state.chosen is not None:
        refuse_symlinks(capture, capture / MATTES)
        (capture / SHEET).unlink(missing_ok=True)
        replace(state, chosen=None, inputs=None).write(capture)


def _input_hash(capture: Path) -> str:
    return hashlib.sha256("\n".join(_versions(_input_files(capture))).encode()).hexdigest()


def _input_files(capture: Path) -> list[Path]:
    return [path for pattern in INPUTS for path in sorted(capture.glob(pattern))]


def _versions(paths: Sequence[Path]) -> Iterator[str]:
    """Yield the name, size and modification time of each file."""
    for path in paths:
        if path.is_file():
            status = path.stat()
            yield f"{path.name} {status.st_size} {status.st_mtime_ns}"


def _learn_subject_model(capture: Capture, settings: MatteSettings, path: Path, workers: int, track: Track) -> None:
    """Learn the models of the subject and of each camera's background, and write them to ``path``."""
    frames = learning_frames(capture.frame_count, len(capture.cameras))
    samples = sample_capture(capture, frames, track)
    moments = reconstruct_moments(capture, frames, settings.seed, workers, track)
    between = passed_frames(capture.frame_count, len(capture.cameras), frames)

    def passed(index: int) -> Iterator[Picture]:
        return (reduce_picture(capture.image(index, frame), samples[index].camera) for frame in between)

    subject = learn_subject(samples, capture.names, settings.seed, track, moments, workers, passed)
    cameras = matting_cameras(capture)
    numbers = range(len(cameras))
    backgrounds = [
        refine_background(capture, index, subject.appearances[index].background, cameras[index])
        for index in track(numbers, len(numbers), "background")
    ]
    save_subject(path, subject, backgrounds, RestingParts.of(subject.solid, frames))


def _screen_colours(capture: Capture, settings: MatteSettings, track: Track) -> tuple[ScreenColour, ...]:
    """Return the screen colour of each camera, from the settings or estimated from a few images."""
    numbers = range(len(capture.names))
    if settings.screen is not None:
        return tuple(parse_screen(settings.screen) for _ in numbers)
    frames = sample_indices(capture.frame_count, SCREEN_FRAMES)
    return tuple(
        find_screen([capture.image(index, frame) for frame in frames])
        for index in track(numbers, len(numbers), "screens")
    )


def _make_network_mattes(
    capture: Capture, settings: MatteSettings, output: MatteOutput, missing: Sequence[int], track: Track
) -> None:
    """Run the network on each camera's frames in order.

    The network starts at the first frame even if the first frame's matte exists, because the recurrent state depends on
    all earlier frames.
    """
    network: RVM | OnnxNetwork
    if settings.method == "onnx":
        if settings.onnx is None:
            raise UserError("--onnx: expected a network file for --method onnx, got none; pass --onnx FILE")
        network = load_onnx(settings.onnx)
    elif settings.rvm is None:
        raise UserError("--rvm: expected a network file for --method rvm, got none; pass --rvm FILE")
    else:
        network = load_rvm(settings.rvm)
    folder = output.start()
    for index, name in enumerate(capture.names):
        remaining = [frame for frame in missing if not (folder / name / f"{capture.frame_names[frame]}.png").exists()]
        if not remaining:
            continue
        frames = range(remaining[-1] + 1)
        mattes = network.mattes(capture.image(index, frame) for frame in frames)
        for frame, matte in zip(frames, track(mattes, len(frames), f"mattes {name}"), strict=True):
            if frame in remaining:
                write_matte(folder / name / f"{capture.frame_names[frame]}.png", matte)


def _convert_masks(
    capture: Capture, settings: MatteSettings, output: MatteOutput, missing: Sequence[int], track: Track
) -> None:
    """Undistort the masks of another program."""
    if settings.masks is None:
        raise UserError("--masks: expected a folder for --method masks, got none; pass --masks FOLDER")
    paths = find_masks(settings.masks, capture, list(missing))
    masks = MaskFolder(settings.masks)
    folder = output.start()
    for (camera, frame), path in track(paths.items(), len(paths), "masks"):
        matte = folder / capture.names[camera] / f"{capture.frame_names[frame]}.png"
        if not matte.exists():
            write_matte(matte, read_mask(path, masks, capture, camera))


@dataclass(frozen=True)
class _Job:
    """Job of a worker process, which computes the mattes of some frames.

    Attributes:
        selection: the capture.
        model: file of the learned model, or the screen colour of each camera.
        folder: output folder.
        frames: frame indices.
        paint: painted images.
    """

    selection: Selection
    model: Path | tuple[ScreenColour, ...]
    folder: Path
    frames: tuple[int, ...]
    paint: tuple[Paint, ...] = ()


def _make_frames(job: _Job) -> Iterator[int]:
    """Compute the mattes of a job's frames, and yield the index of each frame after its files are written."""
    cv2.setNumThreads(1)
    with job.selection.open(mattes=False) as capture:
        maker = load_matte_maker(job.model, matting_cameras(capture)) if isinstance(job.model, Path) else None
        strokes = read_strokes(job.paint, capture, matting_cameras(capture))
        for frame in job.frames:
            if maker is not None:
                mattes = maker.mattes(capture, frame, strokes)
            elif isinstance(job.model, tuple):
                mattes = [chroma_matte(capture.image(index, frame), screen) for index, screen in enumerate(job.model)]
            for name, matte in zip(capture.names, mattes, strict=True):
                path = job.folder / name / f"{capture.frame_names[frame]}.png"
                # Existing mattes of an incomplete frame are kept, because the user may have edited them.
                if not path.exists():
                    write_matte(path, matte)
            yield frame


def write_matte(path: Path, matte: Picture) -> None:
    """Write a matte (H, W) uint8 atomically as PNG."""
    write_picture(path, matte, FASTEST_PNG)
