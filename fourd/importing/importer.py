"""A source of any format as a capture: read, aligned in time, fitted to its pictures, written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path

from fourd.calibration.ambiguities import Centres, settle
from fourd.calibration.scale import Board, Distance, calibrated, gauged
from fourd.capture.calibration import EXTRINSICS_NAME, INTRINSICS_NAME
from fourd.capture.layout import DERIVED, refuse_symlinks, sample_indices
from fourd.capture.video import VideoIndex
from fourd.capture.video_index import kept_indices
from fourd.errors import UserError
from fourd.files import remove_unfinished
from fourd.importing.formats.detection import FORMATS, Format
from fourd.importing.formats.imported import Imported, video_files
from fourd.importing.record import ImportRecord, check_same, check_unpacked, digests, read_record, write_record
from fourd.importing.sample_frames import Moments
from fourd.importing.time_offsets import NO_PROOF, PLOT, find_offsets, sure_offsets
from fourd.importing.writer import ImportSettings, check_import, write_capture
from fourd.progress import Log, Track

Indices = Mapping[str, VideoIndex]

MOST_MOMENTS = 3
FEW_CAMERAS = 5
"""Beyond these one frame has matches enough, and three would take minutes."""


@dataclass(frozen=True)
class ImportOptions:
    """What a person may ask of an import.

    Attributes:
        copy: files are copied in place of linked.
        unpack: videos' frames are written as pictures.
        offsets: frames by which videos run late.
        sync: estimate the offsets, and apply nothing.
        apply_sync: estimate the offsets, and apply those that are sure.
        resize, centres: as :func:`fourd.calibration.ambiguities.settle` has them.
        calibrate: from the pictures, also where there is a calibration.
        distance: between two cameras, for the unit.
        board: a chessboard in the first frames, for the world's axes.
    """

    copy: bool = False
    unpack: bool = False
    offsets: dict[str, int] = field(default_factory=dict)
    sync: bool = False
    apply_sync: bool = False
    resize: str = "auto"
    centres: Centres = "auto"
    calibrate: bool = False
    distance: Distance | None = None
    board: Board | None = None


def pick_format(name: str | None, source: Path) -> Format:
    """The format of that name, or else the first that the source looks like. Raises UserError where there is none."""
    if not source.exists():
        raise UserError(f"{source}: expected what is to be imported, got nothing there; check the path")
    by_name = {each.name: each for each in FORMATS}
    if name is not None and name not in by_name:
        near = get_close_matches(name, by_name, 1)
        hint = f"did you mean '{near[0]}'?" if near else "leave it away to have it found out"
        raise UserError(f"FORMAT: expected one of {', '.join(by_name)}, got '{name}'; {hint}")
    found = by_name[name] if name is not None else next((each for each in FORMATS if each.looks_like(source)), None)
    if found is None:
        raise UserError(
            f"{source}: expected {', or '.join(f'{each.summary} ({each.name})' for each in FORMATS)}, "
            "got none of these; name the folder that holds them"
        )
    return found


def import_source(
    way: Format, source: Path, out: Path, options: ImportOptions, *, log: Log, warn: Log, track: Track
) -> None:
    """Write ``source`` as a capture into the folder ``out``; the same call again completes what is missing.

    Args:
        way: the source's format.
        source: as ``way`` reads it.
        out: a new or empty folder, or one into which this source was imported.
        options: what was asked for.
        say, warn: told what was found and chosen, and what looks wrong, a line each.
        track: for progress.

    Raises:
        UserError: as the importer and what follows it; a calibration is written only at the end.
    """
    refuse_symlinks(out, out / DERIVED)
    before = read_record(out)
    if before is not None:
        check_same(out, before, source, way.name)
    imported = way.read(source)
    if options.sync and options.apply_sync:
        raise UserError("--apply-sync: expected it without --sync, got both; choose one")
    if options.apply_sync and options.offsets:
        raise UserError("--apply-sync: expected it without --offset, got both; choose one")
    check_import(imported, ImportSettings(options.copy, options.unpack, options.offsets))
    needs_calibration = _needs_calibration(imported, source, options)
    if not needs_calibration:
        _check_fitting(imported, options)
    for note in imported.notes:
        log(note)
    calibration, files, asked = *digests(imported), asdict(options)
    same = before is not None and (before.calibration, before.files, before.options) == (calibration, files, asked)
    if before is not None and same and before.done and _has_lenses(out):
        remove_unfinished(out, deep=True)
        indices = kept_indices(video_files(imported.cameras), out, track)
        _write(imported, indices, out, options, before.offsets, track)
        log("done already with these options; nothing to change")
        for line in before.warnings:
            warn(line)
        return
    started = before or ImportRecord(str(source.resolve()), way.name, "", files, {}, {}, False, False, ())
    record = replace(started, calibration=calibration, options=asked, done=False, warnings=())
    check_unpacked(out, started, files, started.offsets)
    write_record(out, record)
    remove_unfinished(out, deep=True)
    indices = kept_indices(video_files(imported.cameras), out, track)
    offsets = dict(options.offsets)
    if options.sync or options.apply_sync:
        offsets = _synced(imported, indices, out, options, log, track)
    check_unpacked(out, started, files, offsets)
    warnings: list[str] = []
    imported = _with_lenses(imported, indices, offsets, options, needs_calibration, log, warnings.append, track)
    record = replace(record, files=files, offsets=offsets, unpacked=started.unpacked or options.unpack)
    write_record(out, record)
    for line in _write(imported, indices, out, options, offsets, track, lenses=True):
        log(line)
    for line in warnings:
        warn(line)
    write_record(out, replace(record, done=True, warnings=tuple(warnings)))


def _has_lenses(out: Path) -> bool:
    return (out / INTRINSICS_NAME).is_file() and (out / EXTRINSICS_NAME).is_file()


def _needs_calibration(imported: Imported, source: Path, options: ImportOptions) -> bool:
    bare = [camera.name for camera in imported.cameras if camera.lens is None]
    if options.calibrate or len(bare) == len(imported.cameras):
        return True
    if bare:
        raise UserError(
            f"{source}: expected a calibration of every camera, got none of {', '.join(bare)}; add it, move their "
            "files away, or calibrate all with --calibrate"
        )
    return False


def _check_fitting(imported: Imported, options: ImportOptions) -> None:
    """A name that is no camera is told before minutes of work, not after."""
    names = [camera.name for camera in imported.cameras]
    for name in (options.distance.first, options.distance.second) if options.distance else ():
        if name not in names:
            raise UserError(f"--scale: expected two cameras among {', '.join(names)}, got '{name}'; name one of them")


def _synced(
    imported: Imported, indices: Indices, out: Path, options: ImportOptions, log: Log, track: Track
) -> dict[str, int]:
    """Tell the estimated offsets; those to apply."""
    found = find_offsets(imported.cameras, indices, out, track)
    names = [camera.name for camera in imported.cameras]
    applied = sure_offsets(names, found) if options.apply_sync else dict(options.offsets)
    for name, frames, sure in zip(names, found.frames, found.confidence, strict=True):
        proof = f"; {NO_PROOF} frames or less prove nothing" if 0 < abs(frames) <= NO_PROOF else ""
        what = "" if not options.apply_sync else ", applied" if name in applied else ", not applied" if frames else ""
        log(f"{name}: {frames:+d} frames, {sure:.0%} sure{what}{proof}")
    log(f"the energies of motion: {out / PLOT}")
    return applied


def _with_lenses(
    imported: Imported,
    indices: Indices,
    offsets: dict[str, int],
    options: ImportOptions,
    needs_calibration: bool,
    log: Log,
    warn: Log,
    track: Track,
) -> Imported:
    """The cameras with lenses that fit their pictures."""
    names = [camera.name for camera in imported.cameras]
    with Moments(imported.cameras, indices, offsets) as moments:
        few = len(names) <= FEW_CAMERAS
        frames = sample_indices(moments.count, MOST_MOMENTS if few and not needs_calibration else 1)
        pictures = [moments.pictures(frame) for frame in track(frames, len(frames), "frames")]
    first = dict(zip(names, pictures[0], strict=True))
    if needs_calibration:
        for _ in track(range(1), 1, "calibrating"):
            lenses, note = calibrated(first)
        log(note)
        if options.distance is None and options.board is None:
            warn("the calibration's unit, origin and axes are arbitrary; give --scale, and --board for the axes")
    else:
        given = [camera.lens for camera in imported.cameras if camera.lens is not None]
        settled = settle(names, given, pictures, resize=options.resize, centres=options.centres, track=track)
        lenses = dict(zip(names, settled.lenses, strict=True))
        for line in settled.notes:
            log(line)
        for line in settled.warnings:
            warn(line)
    lenses, notes = gauged(lenses, first, options.distance, options.board)
    for line in notes:
        log(line)
    return replace(imported, cameras=tuple(replace(camera, lens=lenses[camera.name]) for camera in imported.cameras))


def _write(
    imported: Imported,
    indices: Indices,
    out: Path,
    options: ImportOptions,
    offsets: dict[str, int],
    track: Track,
    lenses: bool = False,
) -> list[str]:
    """Write what is missing; the calibration only when asked to."""
    if not lenses:
        imported = replace(imported, cameras=tuple(replace(camera, lens=None) for camera in imported.cameras))
    return write_capture(imported, indices, out, ImportSettings(options.copy, options.unpack, offsets), track)
