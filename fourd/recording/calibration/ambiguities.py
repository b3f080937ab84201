"""Detection of two calibration errors from the images: images that were resized after the calibration, and principal
points that are mirrored about the image centre."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.progress import Track
from fourd.recording.calibration.camera_matching import match_cameras
from fourd.recording.calibration.checks.agreement import MIN_SHARE
from fourd.recording.calibration.image_sizes import SizeChoice, choose_size, measure_black_borders, size_hypotheses
from fourd.recording.calibration.matching import Matches
from fourd.recording.calibration.principal_points import (
    MAX_COMBINATIONS,
    MirrorChoice,
    choose_principal_points,
    principal_point_hypotheses,
)
from fourd.recording.calibration.residuals import MAX_GOOD_PX, Pair, compute_residuals
from fourd.recording.import_choices import PrincipalPointMode

Picture = NDArray[np.uint8]

CENTRED_HYPOTHESES = ("unchanged", "scaled", "stretched", "letterboxed", "filled", "cropped centre")


@dataclass(frozen=True, eq=False)
class ResolvedCalibration:
    """Cameras whose sizes and principal points were adapted to their images.

    Attributes:
        cameras: one per camera of the calibration, with distortion and the size of the camera's images.
        notes: one line per choice, with the evidence for the choice.
        warnings: suspected errors that were not corrected, one line per error.
    """

    cameras: tuple[Camera, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def resolve_ambiguities(
    names: Sequence[str],
    cameras: Sequence[Camera],
    pictures_by_frame: Sequence[Sequence[Picture]],
    *,
    resize: str = "auto",
    centres: PrincipalPointMode = "auto",
    track: Track | None = None,
) -> ResolvedCalibration:
    """Adapt a calibration to the images' sizes, and check it for mirrored principal points.

    Args:
        names: the cameras' names.
        cameras: the calibration as given.
        pictures_by_frame: for each of a few frames, the stored images (H, W, 3) of all cameras.
        resize: how images were resized after the calibration: a name from
            :func:`fourd.recording.calibration.image_sizes.size_hypotheses`. ``auto`` chooses the hypothesis that best
            fits the images' black borders and feature matches.
        centres: ``as-given`` skips the check of principal points. ``auto`` warns if the residuals are clearly smaller
            with mirrored principal points than with the given ones. ``mirrored`` mirrors principal points if mirroring
            reduces the residuals. The check of principal points needs 2 to 5 cameras.
        track: progress callback.

    Raises:
        UserError: if the evidence for a size hypothesis is not clear, ``resize`` does not explain the images' sizes,
            or ``centres`` is ``mirrored`` and the principal points cannot be checked.
    """
    sizes = [(picture.shape[1], picture.shape[0]) for picture in pictures_by_frame[0]]
    is_checkable = len(cameras) >= 2 and 4 ** len(cameras) <= MAX_COMBINATIONS
    if centres == "mirrored" and not is_checkable:
        raise UserError(
            f"--centres mirrored: expected 2 to 5 cameras, got {len(cameras)}; correct the calibration file"
        )
    resolver = _SizeResolver(names, cameras, sizes, pictures_by_frame, is_checkable, track)
    name, notes, matches = resolver.resolve(resize)
    options = [size_hypotheses(camera, *size) for camera, size in zip(cameras, sizes, strict=True)]
    fitted = tuple(option["unchanged"] if "unchanged" in option else option[name] for option in options)
    if centres == "as-given" or not is_checkable:
        return ResolvedCalibration(fitted, tuple(notes), ())
    if name not in CENTRED_HYPOTHESES:
        if centres == "mirrored":
            raise UserError(
                "--centres mirrored: expected images that are not cropped on one side, got cropped images; correct the "
                "calibration file"
            )
        return ResolvedCalibration(fitted, (*notes, "mirrored principal points: not checked for cropped images"), ())
    if matches is None:
        matches = match_cameras(pictures_by_frame, fitted, track)
    return _resolve_principal_points(names, fitted, matches, centres, notes)


@dataclass(frozen=True)
class _SizeResolver:
    """Finds how the images were resized after the calibration. Each way of resizing is one size hypothesis (see
    :func:`fourd.recording.calibration.image_sizes.size_hypotheses`)."""

    names: Sequence[str]
    cameras: Sequence[Camera]
    sizes: Sequence[tuple[int, int]]
    pictures_by_frame: Sequence[Sequence[Picture]]
    checks_principal_points: bool
    track: Track | None

    def resolve(self, resize: str) -> tuple[str, list[str], dict[Pair, Matches] | None]:
        """Choose the hypothesis of how the images were resized. Returns its name, notes for the user, and the feature
        matches (None if they were not computed)."""
        resized = [i for i, camera in enumerate(self.cameras) if self.sizes[i] != (camera.width, camera.height)]
        if not resized:
            if resize == "auto":
                return "unchanged", [], None
            return "unchanged", [f"--resize {resize}: not needed, since all images have their calibration's size"], None
        self._check_option(None if resize == "auto" else resize, resized)
        matches = None
        if resize == "auto":
            name, why, matches = self._choose(resized)
        else:
            name, why = resize, "given by --resize"
        note = f"{', '.join(self.names[i] for i in resized)}: {self._describe_sizes(resized)}: {name} ({why})"
        return name, [note], matches

    def _check_option(self, asked: str | None, resized: Sequence[int]) -> None:
        """Check that the size hypothesis named ``asked`` explains the sizes of all resized images.

        If ``asked`` is None, check that at least one hypothesis explains the sizes of all resized images.

        Raises:
            UserError: if no suitable hypothesis explains the sizes of all resized images.
        """
        options = [size_hypotheses(self.cameras[i], *self.sizes[i]) for i in resized]
        common = [name for name in options[0] if all(name in option for option in options)]
        cameras = ", ".join(self.names[i] for i in resized)
        if not common:
            raise UserError(
                f"{cameras}: expected images that were all resized by the same method, got sizes that no single method "
                "explains; export the images at the calibration's size"
            )
        if asked is not None and asked not in common:
            raise UserError(f"--resize: expected one of {', '.join(common)} for {cameras}, got '{asked}'")

    def _choose(self, resized: Sequence[int]) -> tuple[str, str, dict[Pair, Matches]]:
        """Choose, from the images, the best hypothesis of how they were resized. Returns its name, the evidence in one
        line, and the feature matches."""
        borders = {i: measure_black_borders([pictures[i] for pictures in self.pictures_by_frame]) for i in resized}
        guess = choose_size({}, self.cameras, self.sizes, borders)
        matches = match_cameras(self.pictures_by_frame, guess.cameras, self.track)
        choice = choose_size(matches, self.cameras, self.sizes, borders)
        if not choice.is_clear and self.checks_principal_points:
            # Mirrored principal points can increase the residuals more than a wrong size hypothesis does, so the
            # hypotheses are compared again with corrected principal points.
            mirrors = _choose_mirrors(matches, choice.cameras)
            if mirrors is not None and mirrors.is_clear:
                corrected = [
                    principal_point_hypotheses(camera)[name]
                    for camera, name in zip(self.cameras, mirrors.names, strict=True)
                ]
                again = choose_size(matches, corrected, self.sizes, borders)
                choice = again if again.is_clear else choice
        if not choice.is_clear:
            raise UserError(
                f"{', '.join(self.names[i] for i in resized)}: expected images of the calibration's size, or images "
                f"that show clearly how they were resized, got {self._describe_sizes(resized)} ({choice.why}); "
                "inspect the images and import them with fourd import --resize NAME"
            )
        widths = [max(b.left, b.top, b.right, b.bottom) for b in borders.values()]
        return choice.name, _evidence(choice, widths), matches

    def _describe_sizes(self, resized: Sequence[int]) -> str:
        cameras, sizes = self.cameras, self.sizes
        changes = dict.fromkeys(
            f"{cameras[i].width} x {cameras[i].height} -> {sizes[i][0]} x {sizes[i][1]}" for i in resized
        )
        return ", ".join(changes)


def _evidence(choice: SizeChoice, widths: Sequence[float]) -> str:
    bars = f"black bars of {min(widths):.1f} to {max(widths):.1f} pixels; " if min(widths) > 0 else ""
    return bars + choice.why


def _choose_mirrors(matches: Mapping[Pair, Matches], cameras: Sequence[Camera]) -> MirrorChoice | None:
    """Choose, for each camera, the given or a mirrored principal point, such that the residuals are smallest. Returns
    None if there are too few feature matches."""
    if not compute_residuals(matches, cameras).pairs:
        return None
    return choose_principal_points(matches, cameras)


def _resolve_principal_points(
    names: Sequence[str],
    cameras: tuple[Camera, ...],
    matches: Mapping[Pair, Matches],
    centres: PrincipalPointMode,
    notes: Sequence[str],
) -> ResolvedCalibration:
    count = sum(map(len, matches.values()))
    found = _choose_mirrors(matches, cameras)
    if found is None:
        if centres == "mirrored":
            raise UserError(
                f"--centres mirrored: expected more matches between cameras, got {count}; correct the calibration file"
            )
        note = f"residuals: too few matches between the cameras ({count}) to check the calibration"
        return ResolvedCalibration(cameras, (*notes, note), ())
    is_given = set(found.names) == {"as given"}
    is_good = found.given_score.median_px <= MAX_GOOD_PX and found.given_score.share >= MIN_SHARE
    mirrored = _describe_mirrors(names, found)
    numbers = (
        f"as given: {found.given_score}; mirrored: {found.chosen_score}; mean over the camera pairs "
        f"{found.given_px:.1f} px as given, {found.chosen_px:.1f} px mirrored, {found.next_px:.1f} px for the second "
        "best choice"
    )
    summary = f"residuals: {found.given_score} of their epipolar lines"
    if centres == "mirrored":
        if is_given or found.chosen_score.median_px >= found.given_score.median_px:
            note = f"--centres mirrored: {summary}; no mirrored principal point fits better"
            return ResolvedCalibration(cameras, (*notes, note), ())
        note = f"principal points mirrored: {mirrored} ({numbers})"
        doubts = () if found.is_clear else (f"mirrored principal points are applied without clear evidence: {numbers}",)
        return ResolvedCalibration(found.cameras, (*notes, note), doubts)
    if found.is_clear and not is_given:
        warning = (
            f"principal points look mirrored: {mirrored} ({numbers}); not changed by the import; fourd make corrects "
            "them by itself, and fourd import with --centres mirrored"
        )
    elif is_good:
        return ResolvedCalibration(cameras, (*notes, summary), ())
    else:
        warning = (
            f"cameras disagree: {summary}; mirrored principal points do not explain the residuals ({numbers}); fourd "
            "make tries to refine the calibration; recalibrate or use --calibrate if that fails"
        )
    return ResolvedCalibration(cameras, tuple(notes), (warning,))


def _describe_mirrors(names: Sequence[str], found: MirrorChoice) -> str:
    return ", ".join(
        f"{name} {choice.removeprefix('mirrored ')}"
        for name, choice in zip(names, found.names, strict=True)
        if choice != "as given"
    )
