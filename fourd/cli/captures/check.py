"""List the contents and all problems of a capture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.text import Text

from fourd.base.errors import UserError, command_line
from fourd.base.progress import Terminal, Tracker
from fourd.base.storage import local_copy
from fourd.base.units import format_length
from fourd.cli.locations import CaptureLocation, transfer_progress
from fourd.recording.capture.frame_rate import UNKNOWN_RATE, format_rate

if TYPE_CHECKING:
    from rich.table import Table

    from fourd.reconstruction.carving.matte_quality import MatteQuality
    from fourd.reconstruction.carving.rig_evidence import RigEvidence
    from fourd.recording.calibration.checks.agreement import Agreement
    from fourd.recording.capture.check import Report

MOST_LINES = 20
DECODE_SECONDS = 60.0
"""All images and mattes are decoded if this probably takes at most this number of seconds."""
SUBJECT_SIDE_PX = 512
"""Longer image side, in pixels, to which mattes are reduced to compare them with the calibration."""
MEASURED_FRAMES = 12
"""Number of frames in which each matte is compared with the visual hull of the other views."""


@dataclass(frozen=True)
class Arguments:
    """The exit code is 0 if fourd can use the capture, else 2. "Good to use" means that the files are whole and that
    matches between the images, or the mattes of the subject, confirm the calibration of every camera.
    """

    capture: CaptureLocation
    """Capture folder, or a URL such as s3://bucket/capture."""
    deep: bool = False
    """Decode all images and mattes to find damaged files, however long it takes. By default, all are decoded if this
    takes at most about a minute; otherwise, a sample is decoded, and the report says how large it is."""
    quick: bool = False
    """Skip the checks that decode images: damaged files, epipolar residuals, time offsets between the cameras, and the
    agreement of the mattes with the visual hull. The skipped checks take a few seconds for 20 cameras of 512 x 512
    pixels."""


def run(arguments: Arguments) -> None:
    """Check the capture and print the report. Raises UserError for the first problem."""
    with local_copy(arguments.capture, transfer_progress()) as capture:
        _check(capture, arguments)


def _check(capture: Path, arguments: Arguments) -> None:
    from fourd.recording.calibration.checks.agreement import check_agreement
    from fourd.recording.calibration.checks.verdict import judge
    from fourd.recording.capture.check import check_capture, first_lines
    from fourd.recording.importing.record import describe_unsure
    from fourd.recording.matting.contours import find_foreign_mattes
    from fourd.recording.sync.lateness import find_late_cameras

    console = Terminal()
    track = Tracker(Terminal(stderr=True)).track
    seconds = 0.0 if arguments.quick else DECODE_SECONDS
    report = check_capture(capture, deep=arguments.deep, decode_seconds=seconds, track=track)
    agreement = quality = subject = None
    found: list[str] = []
    if not (arguments.quick or report.problems):
        try:
            agreement = check_agreement(capture, track)
            report = replace(report, problems=agreement.mixups)
            found += find_late_cameras(capture, track)
            found += find_foreign_mattes(capture, track)
            quality = _quality(capture, report.masked) if report.has_masks else None
            masked = report.masked or report.cameras
            if report.has_masks and {each.name for each in agreement.unverified} & set(masked) and not agreement.mixups:
                subject = _check_subject(capture, masked)
                subject.require(capture)
            if quality is not None:
                quality.require_hull(capture, describe_unsure(capture))
        except UserError as error:
            # Feature matching decodes images, so it can find damage in files that were not decoded before.
            report = replace(report, problems=(*report.problems, str(error)))
    name = str(arguments.capture)
    console.print(_facts(name, report, agreement, quality, subject))
    poor = quality.warnings() if quality else ()
    disagreeing = () if agreement is None or agreement.mixups else agreement.warnings
    warnings = (*report.warnings, *disagreeing, *found, *poor)
    titled = (
        ("note", "bold", report.notes),
        ("warning", "yellow", warnings),
        # The first problem is the message of the error.
        ("problem", "bold red", report.problems[1:]),
    )
    for title, style, lines in titled:
        for line in first_lines(lines, MOST_LINES):
            # If the capture is in an object store such as S3, the check runs on a local copy of it. Messages name the
            # capture's URL, because the user does not know the path of the copy.
            shown = line.replace(str(capture), name)
            console.print(Text(f"{title}: ", style).append(shown, "default"), soft_wrap=True)
    if report.problems:
        more = len(report.problems) - 1
        raise UserError(report.problems[0] + (f" (and {more} more, listed above)" if more else ""))
    verdict = judge(agreement, warnings, is_subject_agreeing=_is_verified(subject, agreement, report))
    console.print(
        Text(verdict.words, "green" if verdict.is_good else "yellow"),
        f"next: {command_line('fourd', 'make', arguments.capture, '-o', 'scene.4dv')}",
        sep="; ",
        soft_wrap=True,
    )


def _quality(path: Path, masked: Sequence[str]) -> MatteQuality | None:
    """Compare the masks of the user, or else the mattes of all cameras, with their visual hull."""
    from fourd.reconstruction.carving.matte_quality import measure_mattes
    from fourd.recording.capture import open_capture

    with open_capture(path, views=masked or None) as capture:
        return measure_mattes(capture, max_frames=MEASURED_FRAMES, track=Tracker(Terminal(stderr=True)).track)


def _check_subject(path: Path, masked: Sequence[str]) -> RigEvidence:
    """Compare the calibration of the cameras that have masks with their masks."""
    from fourd.reconstruction.carving.rig_evidence import check_rig
    from fourd.recording.capture import open_capture

    with open_capture(path, views=masked) as whole:
        largest = max(max(camera.width, camera.height) for camera in whole.cameras)
    with open_capture(path, views=masked, scale=min(1.0, SUBJECT_SIDE_PX / largest)) as capture:
        return check_rig(capture)


def _is_verified(subject: RigEvidence | None, agreement: Agreement | None, report: Report) -> bool:
    """Return whether the masks verify all cameras that the matches do not verify."""
    if subject is None or agreement is None or subject.finding != "verified":
        return False
    return {each.name for each in agreement.unverified} <= set(report.masked or report.cameras)


def _facts(
    name: str,
    report: Report,
    agreement: Agreement | None,
    quality: MatteQuality | None,
    subject: RigEvidence | None,
) -> Table:
    from rich.table import Table

    from fourd.recording.calibration.checks.verdict import describe_residuals, describe_verified

    sizes = Counter(f"{width} x {height}" for width, height in report.sizes.values())
    table = Table(title=Text(name), title_justify="left", show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_row("cameras", f"{len(report.cameras)}: {', '.join(report.cameras)}")
    rate = f" at {format_rate(report.fps)} per second" if report.fps else f"; {UNKNOWN_RATE}"
    table.add_row("frames", f"{report.frames}{rate}")
    table.add_row("images", ", ".join(f"{size} ({count})" for size, count in sizes.items()) or "none")
    table.add_row("distortion", f"in {report.distorted} cameras" if report.distorted else "none")
    distance = format_length(report.ring_radius, report.metres_per_unit)
    table.add_row("distance", f"{distance} from the cameras to the point they face")
    if agreement is not None:
        table.add_row("residuals", describe_residuals(agreement))
        table.add_row("calibration", describe_verified(agreement))
        if agreement.colours is not None:
            table.add_row("colours", agreement.colours.describe())
    if subject is not None:
        table.add_row("subject", str(subject))
    coverage = "" if report.coverage is None else f"; {report.coverage:.1%} of the pixels are foreground"
    kept = "" if quality is None else f"; the visual hull covers {quality.kept_share:.0%} of them"
    mattes = "yes" if report.has_masks else "none; fourd make or fourd matte makes them"
    unmasked = [name for name in report.cameras if name not in report.masked]
    if report.masked and unmasked:
        mattes = (
            f"masks of {len(report.masked)} of {len(report.cameras)} cameras; fourd make, train and matte make mattes "
            f"of the others: {', '.join(unmasked)}"
        )
    table.add_row("mattes", mattes + coverage + kept)
    if report.test_views is not None:
        table.add_row("held out", f"{', '.join(report.test_views) or 'no camera'} by default (test split)")
    if report.skipped is not None:
        table.add_row("damage", str(report.skipped))
    table.add_row("size", f"{report.nbytes / 1e6:.1f} MB")
    return table
