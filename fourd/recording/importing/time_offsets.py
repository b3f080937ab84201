"""Time offsets between a source's cameras, estimated from their soundtracks or from the motion in their images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.progress import Log, Track
from fourd.recording.capture.focus import find_focus
from fourd.recording.capture.layout import DERIVED
from fourd.recording.capture.video import VideoIndex
from fourd.recording.import_choices import SyncMethod
from fourd.recording.importing.imported import ImportedCamera, video_files
from fourd.recording.importing.sample_frames import SynchronizedFrames
from fourd.recording.sync.epipolar import MotionRecord, estimate_epipolar_offsets
from fourd.recording.sync.motion import (
    MIN_CONFIDENCE,
    MIN_OVERLAP,
    UNRELIABLE_FRAMES,
    WIDTH_PX,
    Offsets,
    estimate_offsets,
    plot_offsets,
)
from fourd.recording.sync.sound import SPEED_OF_SOUND, Soundtrack, estimate_sound_offsets, read_soundtrack, travel_times

MAX_OFFSET_FRAMES = 300
MIN_CANDIDATE = 0.1
"""An offset that is not applied is named to the user only if its confidence is at least this value."""
DECIMALS = 2
"""Applied offsets, in frames, are rounded to this number of decimals."""
PLOT = DERIVED / "sync.png"

SoundPosition = Literal["auto", "none", "centre"] | tuple[float, float, float]
"""Position of the sound source in world units. "centre" is the point that the cameras face. "none" means no correction.
"auto" means "centre" if the world is in metres, and "none" otherwise."""


class NoCommonSoundError(UserError):
    """Error: the offsets of some cameras cannot be estimated from the soundtracks."""


@dataclass(frozen=True)
class Estimate:
    """Estimated delays of all videos relative to the first camera's video.

    Attributes:
        method: "sound", "motion" (the motion energies of whole images), or "epipolar" (the motion in epipolar planes).
        frames: delays in (fractional) frames of the common clock, keyed by camera name.
        confidence: confidence in [0, 1] of each delay.
        rate: frame rate of the common clock in 1/s.
        motion: the motion in each camera's images, or empty if the delays were estimated from sound.
    """

    method: Literal["sound", "motion", "epipolar"]
    frames: dict[str, float]
    confidence: dict[str, float]
    rate: float
    motion: dict[str, MotionRecord] = field(default_factory=dict, repr=False)

    def is_sure(self, name: str) -> bool:
        """Return whether --apply-sync applies the estimated delay of a camera.

        Small delays from motion may be errors of synchronous cameras. Delays from epipolar planes are exact to about a
        frame, so small ones are doubted only as long as no other camera has a large one.
        """
        is_known = self.confidence[name] >= MIN_CONFIDENCE
        if self.method == "epipolar":
            return is_known and any(self._is_large(n) and c >= MIN_CONFIDENCE for n, c in self.confidence.items())
        return is_known and (self.method == "sound" or self._is_large(name))

    def candidates(self, given: Mapping[str, float]) -> dict[str, float]:
        """Return the large delays that are not sure enough to be applied, but sure enough to be named. Those of cameras
        whose offsets are ``given`` are left out."""
        return {
            name: round(frames, DECIMALS)
            for name, frames in self.frames.items()
            if name not in given and self._is_large(name) and MIN_CANDIDATE <= self.confidence[name] < MIN_CONFIDENCE
        }

    def _is_large(self, name: str) -> bool:
        return abs(round(self.frames[name])) > UNRELIABLE_FRAMES


def estimate_offsets_of(
    cameras: tuple[ImportedCamera, ...],
    indices: Mapping[str, VideoIndex],
    out: Path,
    method: SyncMethod,
    log: Log,
    track: Track,
) -> Estimate:
    """Estimate the delays of the cameras from sound or motion.

    If ``method`` is "auto", the delays are estimated from sound if all videos have recorded the same sound, and from
    motion otherwise. The log states the method and the reason for it.

    Raises:
        UserError: if there are too few frames, or if a frame or soundtrack cannot be decoded. If ``method`` is "sound",
            UserError is also raised if a soundtrack is missing, is silent, or does not match the other soundtracks.
    """
    rate = float(min((index.fps for index in indices.values()), default=Fraction(1)))
    if method != "motion":
        try:
            return _from_sound(cameras, indices, rate, track)
        except NoCommonSoundError as error:
            if method == "sound":
                raise
            log(f"offsets are estimated from motion, because sound gives no offsets: {str(error).rpartition('; ')[0]}")
    found, records = find_offsets(cameras, indices, out, track)
    log(f"plot of the motion energies: {out / PLOT}")
    names = [camera.name for camera in cameras]
    frames, confidence = (dict(zip(names, values, strict=True)) for values in (found.subframes, found.confidence))
    return Estimate("motion", frames, confidence, rate, dict(zip(names, records, strict=True)))


def estimate_if_possible(
    cameras: tuple[ImportedCamera, ...], indices: Mapping[str, VideoIndex], out: Path, log: Log, track: Track
) -> Estimate | None:
    """Estimate the delays of the cameras as :func:`estimate_offsets_of` does with the method "auto". If that is not
    possible, for example because the cameras recorded images or the videos are short, log the reason and return
    None."""
    if len(video_files(cameras)) < len(cameras) or len(cameras) < 2:
        return None
    try:
        return estimate_offsets_of(cameras, indices, out, "auto", log, track)
    except UserError as error:
        reason = str(error).removeprefix("--sync: ").split(";")[0]
        log(f"time offsets between the videos are not estimated: {reason}")
        return None


def _from_sound(
    cameras: tuple[ImportedCamera, ...], indices: Mapping[str, VideoIndex], rate: float, track: Track
) -> Estimate:
    """Estimate the delays from the soundtracks. Raises NoCommonSoundError if the delay of a camera is uncertain."""
    files = video_files(cameras)
    if len(files) < len(cameras):
        raise NoCommonSoundError("--sync-by sound: expected videos with sound, got images; use --sync-by motion")
    soundtracks: dict[str, Soundtrack] = {}
    silent = []
    for name in track(list(files), len(files), "soundtracks"):
        found = read_soundtrack(files[name], float(indices[name].start))
        if found is None:
            raise NoCommonSoundError(
                f"{files[name]}: expected a video with a soundtrack, got no soundtrack; use --sync-by motion"
            )
        soundtracks[name] = found
        if found.is_silent:
            silent.append(name)
    if silent:
        raise NoCommonSoundError(
            f"{files[silent[0]]}: expected a soundtrack with sound, got silence in {', '.join(silent)}; switch the "
            "microphones on, or use --sync-by motion"
        )
    for _ in track(range(1), 1, "correlating sound"):
        offsets = estimate_sound_offsets(list(soundtracks.values()))
    confidence = dict(zip(files, offsets.confidence, strict=True))
    unsure = [name for name in files if confidence[name] < MIN_CONFIDENCE]
    if unsure:
        worst = min(unsure, key=confidence.__getitem__)
        height = dict(zip(files, offsets.sigmas, strict=True))[worst]
        raise NoCommonSoundError(
            f"{files[worst]}: expected sound that all cameras record, got nothing in common in {', '.join(unsure)} "
            f"(best match {height:.1f} standard deviations, confidence {confidence[worst]:.0%}); use --sync-by motion"
        )
    frames = {name: seconds * rate for name, seconds in zip(files, offsets.seconds, strict=True)}
    return Estimate("sound", frames, confidence, rate)


def find_offsets(
    cameras: tuple[ImportedCamera, ...], indices: Mapping[str, VideoIndex], out: Path, track: Track
) -> tuple[Offsets, list[MotionRecord]]:
    """Estimate from motion how much each camera is delayed relative to the first camera. Plot the delays to
    ``out``/.fourd/sync.png. Returns the delays, and the motion in the images of each camera.

    The maximum offset is n // 3, n - MIN_OVERLAP or MAX_OFFSET_FRAMES, whichever is smallest, where n is the number of
    frames of the camera with the fewest frames.

    Raises:
        UserError: when there are too few frames, or a frame cannot be decoded.
    """
    with SynchronizedFrames(cameras, indices, {}) as frames:
        max_offset = min(frames.count // 3, frames.count - MIN_OVERLAP, MAX_OFFSET_FRAMES)
        if max_offset < 1:
            raise UserError(
                f"--sync: expected more than {MIN_OVERLAP} frames per camera, got {frames.count}; use --offset instead"
            )
        records = []
        for index, name in enumerate(frames.names):
            numbers = track(range(frames.counts[index]), frames.counts[index], f"motion of {name}")
            records.append(MotionRecord.of(_reduced_frames(frames, index, numbers)))
    energies = [record.energies for record in records]
    found = estimate_offsets(energies, max_offset)
    plot_offsets(out / PLOT, frames.names, energies, found)
    return found, records


def estimate_with_cameras(estimate: Estimate, cameras: Sequence[ImportedCamera], log: Log) -> Estimate:
    """Estimate delays from motion again, now that the cameras are calibrated, from the motion in common epipolar
    planes. The energies of whole images are only a guess: with a confidence of 30 to 50%, most of their delays can be
    wrong, and with more than 50% a third (docs/lab/calibration.md).

    Estimates from sound, and estimates for which a calibration is missing or which have too few frames, are returned
    unchanged.
    """
    calibrations = [camera.calibration for camera in cameras if camera.calibration is not None]
    if estimate.method != "motion" or len(calibrations) < len(estimate.motion):
        return estimate
    found = estimate_epipolar_offsets(list(estimate.motion.values()), calibrations, MAX_OFFSET_FRAMES)
    if found is None:
        return estimate
    log("the cameras are calibrated: offsets are estimated from the motion in common epipolar planes")
    frames, confidence = (dict(zip(estimate.motion, each, strict=True)) for each in (found.subframes, found.confidence))
    return replace(estimate, method="epipolar", frames=frames, confidence=confidence)


def correct_sound_travel(
    estimate: Estimate, cameras: Sequence[ImportedCamera], position: SoundPosition, is_metric: bool, log: Log
) -> Estimate:
    """Correct estimated delays by the time that sound takes to travel to each calibrated camera.

    The delay between two soundtracks is the sum of the videos' time offset and the difference of the sound's travel
    times. To separate the two, the position of the sound source must be known. The user can specify the position;
    otherwise, the point that the cameras face is used.

    Args:
        estimate: delays of the videos. Delays from motion are returned unchanged.
        cameras: cameras with their calibrations.
        position: position of the sound source.
        is_metric: whether one world unit is known to be one metre.
        log: called with one line that states the correction, or the reason why there is none.
    """
    if estimate.method != "sound" and position not in ("auto", "none"):
        log("--sound-at is not used, because offsets from motion contain no travel time of sound")
    if estimate.method != "sound" or position == "none":
        return estimate
    if position == "auto" and not is_metric:
        log(
            "the travel time of sound is not corrected, because the unit of the calibration is possibly not the "
            "metre (sound needs 29 ms for 10 m); correct it with --sound-at centre"
        )
        return estimate
    placed = {camera.name: camera.calibration for camera in cameras if camera.calibration is not None}
    if isinstance(position, tuple):
        source: NDArray[np.float64] | None = np.array(position, np.float64)
    else:
        source = find_focus(list(placed.values()))
    if source is None:
        log("the travel time of sound is not corrected, because the cameras face no common point; use --sound-at X,Y,Z")
        return estimate
    seconds = travel_times({name: camera.centre for name, camera in placed.items()}, source)
    first = next(iter(estimate.frames))
    late = {name: seconds[name] - seconds[first] for name in estimate.frames}
    largest = max(late, key=lambda name: abs(late[name]))
    place = ", ".join(f"{value:.2f}" for value in source)
    log(
        f"the travel time of sound from ({place}) is corrected at {SPEED_OF_SOUND:g} m/s, by up to "
        f"{1e3 * abs(late[largest]):.1f} ms ({largest})"
    )
    return replace(estimate, frames={name: of - late[name] * estimate.rate for name, of in estimate.frames.items()})


def applied_offsets(estimate: Estimate | None, given: Mapping[str, float], apply: bool) -> dict[str, float]:
    """Return the offsets to apply, in frames: the user's offsets. If ``apply`` is true, also the estimated offsets of
    other cameras that have a high confidence."""
    if estimate is None or not apply:
        return dict(given)
    sure = {name: round(of, DECIMALS) for name, of in estimate.frames.items() if estimate.is_sure(name)}
    return {**sure, **given}


def describe_offsets(estimate: Estimate, given: Mapping[str, float], apply: bool) -> Iterator[str]:
    """Yield one line per camera with its offset and confidence. If ``apply`` is true, the line also states whether the
    offset is applied, or the user's offset that replaces it."""
    candidates = estimate.candidates(given)
    for name, frames in estimate.frames.items():
        state = ""
        if apply:
            state = ", applied" if estimate.is_sure(name) else ", not applied" if round(frames) else ""
        is_applied = apply and estimate.is_sure(name)
        hint = ""
        if name in given:
            state = f", not applied, because --offset sets {given[name]:+g}"
        elif apply and name in candidates:
            hint = f"; --offset {name}={candidates[name]:g} applies it"
        elif estimate.method != "sound" and 0 < abs(round(frames)) <= UNRELIABLE_FRAMES and not is_applied:
            hint = f"; offsets up to {UNRELIABLE_FRAMES} frames are within the error of the estimate"
        exact = f"{1e3 * frames / estimate.rate:+.1f} ms by sound" if estimate.method == "sound" else f"{frames:+.2f}"
        yield f"{name}: {round(frames):+d} frames ({exact}), confidence {estimate.confidence[name]:.0%}{state}{hint}"


def _reduced_frames(frames: SynchronizedFrames, index: int, numbers: Iterable[int]) -> Iterator[NDArray[np.uint8]]:
    for number in numbers:
        grey = cv2.cvtColor(frames.picture(index, number), cv2.COLOR_RGB2GRAY)
        height = max(1, round(grey.shape[0] * WIDTH_PX / grey.shape[1]))
        yield np.asarray(cv2.resize(grey, (WIDTH_PX, height), interpolation=cv2.INTER_AREA), np.uint8)
