"""Import of a source in any format: reading, time alignment, calibration, and writing of the capture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from fourd.base.cameras import describe_equal_positions
from fourd.base.errors import UserError
from fourd.base.files import remove_unfinished, resolved
from fourd.base.progress import Log, Track
from fourd.recording.calibration.ambiguities import resolve_ambiguities
from fourd.recording.calibration.chessboard import Board
from fourd.recording.calibration.scale import Distance, set_world_frame
from fourd.recording.calibration.structure_from_motion import calibrate_from_pictures
from fourd.recording.capture.focus import describe_inverted
from fourd.recording.capture.frame_rate import FPS_IS_FOR_PICTURES, read_rate, standard_rate
from fourd.recording.capture.layout import DERIVED, EXTRINSICS_NAME, INTRINSICS_NAME, refuse_symlinks, sample_indices
from fourd.recording.capture.pictures.alpha import ALPHA_NOTE, alpha_is_matte
from fourd.recording.capture.pictures.masks import MaskFolder
from fourd.recording.capture.video import VideoIndex
from fourd.recording.capture.video_index import cached_indices
from fourd.recording.capture.video_list import align_videos
from fourd.recording.import_choices import CalibratedFrames, PairBy, PrincipalPointMode, SyncMethod
from fourd.recording.importing.detection import Format
from fourd.recording.importing.frame_geometry import match_calibrations, reduced_indices
from fourd.recording.importing.given_calibration import apply_calibration
from fourd.recording.importing.imported import Imported, VideoFile, video_files
from fourd.recording.importing.pictures.geometry import match_pictures
from fourd.recording.importing.pictures.moments import align_pictures
from fourd.recording.importing.record import (
    ImportRecord,
    check_same_source,
    check_unpacked,
    digests,
    read_record,
    write_record,
)
from fourd.recording.importing.sample_frames import SynchronizedFrames
from fourd.recording.importing.time_offsets import (
    Estimate,
    SoundPosition,
    applied_offsets,
    correct_sound_travel,
    describe_offsets,
    estimate_if_possible,
    estimate_offsets_of,
    estimate_with_cameras,
)
from fourd.recording.importing.writer import ImportSettings, check_import, write_capture
from fourd.recording.soundtrack.captures import keep_sound

Indices = Mapping[str, VideoIndex]

LATER = "later"
"""No sound is written, because it is chosen when a scene is made from the capture."""

MAX_SAMPLE_FRAMES = 3
"""Number of frames whose images are matched to check a calibration of at most FEW_CAMERAS cameras."""
FEW_CAMERAS = 5
"""If there are more cameras than this number, the images of only one frame are matched. One frame then has enough
matches, and matching three frames would take minutes."""


@dataclass(frozen=True)
class ImportOptions:
    """A user's options for an import.

    Attributes:
        copy: copy files instead of linking them.
        unpack: write the frames of videos as images.
        offsets: time offsets of the videos in frames of the capture, keyed by camera name. Missing offsets are 0. In a
            video with the offset n, each event appears n frames later than in a video with the offset 0. They replace
            estimated offsets.
        sync: estimate the offsets without applying them.
        apply_sync: estimate the offsets and apply those with high confidence.
        sync_if_possible: like ``apply_sync``, but videos whose offsets cannot be estimated are no error.
        fps: frame rate of images in 1/s, or None if it is not known.
        sync_by: method of the estimate: "sound", "motion" or "auto". "auto" uses sound if all videos have recorded the
            same sound, and motion otherwise.
        sound_at: position of the sound source in the world, which is used to correct the sound's travel time; see
            :func:`fourd.recording.importing.time_offsets.correct_sound_travel`.
        resize, centres: how images were resized after the calibration, and whether mirrored principal points are
            corrected; see :func:`fourd.recording.calibration.ambiguities.resolve_ambiguities`.
        calibrate: calibrate from the images even if the source has a calibration.
        reduce: factor in (0, 1] that multiplies width and height of the frames of videos.
        calibrated_frames: whether the calibrations of rotated videos belong to the stored or to the upright frames; see
            :func:`fourd.recording.importing.frame_geometry.match_calibrations`.
        distance: known distance between two cameras, which sets the scale of the world.
        board: chessboard in the first frames, which sets the world's origin and axes.
        calibration: folder with intri.yml and extri.yml for videos without a calibration.
        pair_by: how images of different cameras are paired by moment; see
            :func:`fourd.recording.importing.pictures.moments.align_pictures`.
    """

    copy: bool = False
    unpack: bool = False
    offsets: dict[str, float] = field(default_factory=dict)
    sync: bool = False
    apply_sync: bool = False
    sync_if_possible: bool = False
    sync_by: SyncMethod = "auto"
    sound_at: SoundPosition = "auto"
    fps: float | None = None
    resize: str = "auto"
    centres: PrincipalPointMode = "auto"
    calibrate: bool = False
    reduce: float = 1.0
    calibrated_frames: CalibratedFrames = "auto"
    distance: Distance | None = None
    board: Board | None = None
    calibration: str | None = None
    pair_by: PairBy = "auto"

    @property
    def applies_estimate(self) -> bool:
        """Whether estimated offsets of high confidence are applied."""
        return self.apply_sync or self.sync_if_possible


def import_source(
    source_format: Format,
    source: Path,
    out: Path,
    options: ImportOptions,
    *,
    log: Log,
    warn: Log,
    track: Track,
    sound: str = LATER,
) -> None:
    """Write ``source`` as a capture into the folder ``out``. To complete an interrupted import, call the function
    again. The calibration files are written after the images, videos and mattes.

    Args:
        source_format: format of the source.
        source: file or folder in this format.
        out: a new or empty folder, or a folder with an earlier import of this source.
        options: the user's options.
        log: called with one line for each result or choice.
        warn: called with one line for each suspected error.
        track: wraps loops to report progress.
        sound: see :func:`fourd.recording.soundtrack.choice.choose_sound`; with LATER, no sound is written.

    Raises:
        UserError: when the source or an option is invalid.
    """
    refuse_symlinks(out, out / DERIVED)
    before = read_record(out)
    if before is not None:
        check_same_source(out, before, source, source_format.name)
    imported, warnings, needs_calibration = _read_and_check(source_format, source, options)
    _tell_all(imported.notes, log)
    calibration, files, asked = *digests(imported), asdict(options)
    same = before is not None and (before.calibration, before.files, before.options) == (calibration, files, asked)
    if before is not None and same and sound in (LATER, before.sound) and before.done and _has_calibration(out):
        _confirm(imported, before, out, options, log, warn, track)
        return
    started = before or ImportRecord(str(resolved(source)), source_format.name, "", files, {}, {}, False, False, ())
    record = replace(started, calibration=calibration, options=asked, done=False, warnings=())
    record = record if sound == LATER else replace(record, sound=sound)
    check_unpacked(out, started, files, started.offsets, options.reduce)
    write_record(out, record)
    remove_unfinished(out, deep=True)
    indices = _read_indices(imported, out, options, track)
    estimate = _estimate(imported, indices, out, options, log, track)
    offsets = applied_offsets(estimate, options.offsets, options.applies_estimate)
    imported = _match_calibrations(imported, indices, options, log, track)
    imported = _calibrate(imported, indices, offsets, options, needs_calibration, log, warnings.append, track)
    if estimate is not None:
        estimate = _correct_estimate(estimate, imported, options, log)
        offsets = applied_offsets(estimate, options.offsets, options.applies_estimate)
        record = replace(record, unsure=estimate.candidates(offsets))
    check_unpacked(out, started, files, offsets, options.reduce)
    record = replace(record, files=files, offsets=offsets, unpacked=started.unpacked or options.unpack)
    write_record(out, record)
    notes = _write(imported, indices, out, options, offsets, track, with_calibration=True, sound=sound)
    _tell_all((*notes, *_describe_mattes(out, warnings)), log)
    _tell_all(warnings, warn)
    write_record(out, replace(record, done=True, warnings=tuple(warnings)))


def _read_and_check(source_format: Format, source: Path, options: ImportOptions) -> tuple[Imported, list[str], bool]:
    """Read a source, and check the options. Returns its content, warnings, and whether its cameras must be calibrated
    from their images."""
    imported, warnings = align_pictures(_read(source_format, source, options), options.pair_by)
    if options.calibration is not None:
        imported = apply_calibration(imported, source_format.name, Path(options.calibration))
    needs_calibration = _check_options(imported, source, options)
    return imported, warnings + ([] if needs_calibration else _check_poses(imported, source)), needs_calibration


def _confirm(
    imported: Imported, before: ImportRecord, out: Path, options: ImportOptions, log: Log, warn: Log, track: Track
) -> None:
    """Write the files that are missing in the folder of a finished import with the same options."""
    remove_unfinished(out, deep=True)
    indices = _read_indices(imported, out, options, track)
    _write(imported, indices, out, options, before.offsets, track, with_calibration=False)
    log("the import with these options already exists; no file is changed")
    _tell_all(before.warnings, warn)


def _tell_all(lines: Sequence[str], tell: Log) -> None:
    for line in lines:
        tell(line)


def _correct_estimate(estimate: Estimate, imported: Imported, options: ImportOptions, log: Log) -> Estimate:
    """Improve the estimated offsets with the calibrated cameras, and log them. Offsets from sound are corrected by the
    time that the sound takes to reach each camera; offsets from motion are estimated again in epipolar planes."""
    is_metric = imported.metres_per_unit == 1
    corrected = correct_sound_travel(estimate, imported.cameras, options.sound_at, is_metric, log)
    corrected = estimate_with_cameras(corrected, imported.cameras, log)
    for line in describe_offsets(corrected, options.offsets, options.applies_estimate):
        log(line)
    return corrected


def _check_options(imported: Imported, source: Path, options: ImportOptions) -> bool:
    """Check the options before the import starts. Returns whether the cameras must be calibrated from their images."""
    if options.sync and options.apply_sync:
        raise UserError("--apply-sync: expected no --sync, got both options; choose one")
    if options.calibrate and options.calibration is not None:
        raise UserError("--calibrate: expected no --calibration, got both options; choose one")
    if not (options.sync or options.apply_sync) and (options.sync_by, options.sound_at) != ("auto", "auto"):
        raise UserError("--sync-by, --sound-at: expected --sync or --apply-sync, got none of them; add one of them")
    check_import(imported, ImportSettings(options.copy, options.unpack, options.offsets))
    for camera in imported.cameras if options.reduce != 1 else ():
        if not isinstance(camera.frames, VideoFile) or camera.masks is not None:
            got = "masks" if camera.masks else "images"
            raise UserError(
                f"--scale {options.reduce:g}: expected videos without masks, got {got} "
                f"of '{camera.name}'; omit the option and train with image_scale: {options.reduce:g} instead"
            )
    names = [camera.name for camera in imported.cameras]
    uncalibrated = [camera.name for camera in imported.cameras if camera.calibration is None]
    if options.calibrate or len(uncalibrated) == len(names):
        return True
    if uncalibrated:
        raise UserError(
            f"{source}: expected a calibration of every camera, got none for {', '.join(uncalibrated)}; add the "
            "missing calibrations, move the files of these cameras away, or calibrate all cameras with --calibrate"
        )
    for name in (options.distance.first, options.distance.second) if options.distance else ():
        if name not in names:
            raise UserError(f"--scale: expected two cameras among {', '.join(names)}, got '{name}'; name one of them")
    return False


def _estimate(
    imported: Imported, indices: Indices, out: Path, options: ImportOptions, log: Log, track: Track
) -> Estimate | None:
    """Estimate the offsets of the videos if an option requests it. They are logged later, because calibrated cameras
    improve them."""
    if options.sync_if_possible:
        found = estimate_if_possible(imported.cameras, indices, out, log, track)
        if found is None:
            return None
        return found
    if options.sync or options.apply_sync:
        return estimate_offsets_of(imported.cameras, indices, out, options.sync_by, log, track)
    return None


def _read(source_format: Format, source: Path, options: ImportOptions) -> Imported:
    """Read a source, and set the unit of its calibration and the frame rate of a source that consists of images.

    The rate is the value of --fps, or the rate in capture.json if the source is a capture.
    """
    imported = source_format.read(source)
    if source_format.is_metric:
        imported = replace(imported, metres_per_unit=1.0)
    if options.fps is not None and video_files(imported.cameras):
        raise UserError(f"--fps: {source}: {FPS_IS_FOR_PICTURES}")
    stored = read_rate(source) if source.is_dir() else None
    return replace(imported, fps=stored if options.fps is None else standard_rate(options.fps))


def _read_indices(imported: Imported, out: Path, options: ImportOptions, track: Track) -> Indices:
    """Return the :class:`~fourd.recording.capture.video.VideoIndex` of each video: frame size, frame times and
    keyframes. The frame sizes are multiplied by the factor of the option --scale."""
    return reduced_indices(cached_indices(video_files(imported.cameras), out, track), options.reduce)


def _match_calibrations(
    imported: Imported, indices: Indices, options: ImportOptions, log: Log, track: Track
) -> Imported:
    cameras, notes = match_calibrations(imported.cameras, indices, options.calibrated_frames, options.reduce)
    imported, turned = match_pictures(replace(imported, cameras=cameras), options.calibrated_frames, track)
    for note in (*notes, *turned):
        log(note)
    return imported


def _describe_mattes(out: Path, warnings: list[str]) -> list[str]:
    """Return notes on how the masks or alpha channels of a written capture are read. An error in them is appended to
    ``warnings``, because the capture itself is complete."""
    try:
        return [ALPHA_NOTE] if alpha_is_matte(out) else MaskFolder(out / "masks").notes()
    except UserError as error:
        warnings.append(str(error))
        return []


def _check_poses(imported: Imported, source: Path) -> list[str]:
    """Return a warning if the poses of a source look like camera-to-world. Raises UserError if they surely are."""
    inverted = describe_inverted([camera.calibration for camera in imported.cameras if camera.calibration is not None])
    if inverted is not None and inverted.is_sure:
        raise UserError(f"{source}: {inverted.reason}; invert the poses of all cameras")
    return [] if inverted is None else [f"{source}: {inverted.reason}; check the poses"]


def _has_calibration(out: Path) -> bool:
    return (out / INTRINSICS_NAME).is_file() and (out / EXTRINSICS_NAME).is_file()


def _calibrate(
    imported: Imported,
    indices: Indices,
    offsets: dict[str, float],
    options: ImportOptions,
    needs_calibration: bool,
    log: Log,
    warn: Log,
    track: Track,
) -> Imported:
    """Calibrate the source's cameras from its images, or check the given calibration with these images. Return the
    source with the resulting cameras."""
    names = [camera.name for camera in imported.cameras]
    with SynchronizedFrames(imported.cameras, indices, offsets) as frames:
        has_few = len(names) <= FEW_CAMERAS
        numbers = sample_indices(frames.count, MAX_SAMPLE_FRAMES if has_few and not needs_calibration else 1)
        pictures = [frames.pictures(frame) for frame in track(numbers, len(numbers), "frames")]
        frames.check_sizes(numbers, pictures)
    first = dict(zip(names, pictures[0], strict=True))
    if needs_calibration:
        for _ in track(range(1), 1, "calibrating"):
            found = calibrate_from_pictures({name: [picture] for name, picture in first.items()})
        cameras = found.cameras
        log(
            f"calibrated from the images: {len(cameras)} cameras, {found.points} points, "
            f"{found.error_px:.2f} px reprojection error"
        )
        if options.distance is None and options.board is None:
            warn("the calibration's unit, origin and axes are arbitrary; set the unit by --scale, the axes by --board")
    else:
        given = [camera.calibration for camera in imported.cameras if camera.calibration is not None]
        resolved = resolve_ambiguities(
            names, given, pictures, resize=options.resize, centres=options.centres, track=track
        )
        cameras = dict(zip(names, resolved.cameras, strict=True))
        for line in resolved.notes:
            log(line)
        for line in resolved.warnings:
            warn(line)
    for line in describe_equal_positions(cameras):
        warn(line)
    if len(cameras) == 1:
        warn(f"camera '{names[0]}' is the only one; a scene needs the recordings of at least 2 cameras")
    world = set_world_frame(cameras, first, options.distance, options.board)
    for line in world.notes:
        log(line)
    moved = tuple(replace(camera, calibration=world.cameras[camera.name]) for camera in imported.cameras)
    unit = None if needs_calibration else imported.metres_per_unit
    return replace(imported, cameras=moved, metres_per_unit=1.0 if world.is_metric else unit)


def _write(
    imported: Imported,
    indices: Indices,
    out: Path,
    options: ImportOptions,
    offsets: dict[str, float],
    track: Track,
    *,
    with_calibration: bool,
    sound: str = LATER,
) -> list[str]:
    """Write the files that are missing in ``out``. If ``with_calibration`` is true, also write the calibration. Returns
    notes for the user.
    """
    if not with_calibration:
        imported = replace(imported, cameras=tuple(replace(camera, calibration=None) for camera in imported.cameras))
    notes = write_capture(imported, indices, out, ImportSettings(options.copy, options.unpack, offsets), track)
    if sound != LATER:
        notes += keep_sound(out, sound, align_videos(video_files(imported.cameras), indices, offsets), track)
    return notes
