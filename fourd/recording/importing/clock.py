"""Notes that an import prints for the user. They describe the common clock of the videos, and how their frames are
converted."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fourd.recording.capture.frame_rate import format_rate
from fourd.recording.capture.streams.picture import HLG_PEAK, KNEE, REFERENCE_WHITE, shown_size
from fourd.recording.capture.video import VideoIndex
from fourd.recording.capture.video_list import Video, common_frames

LONG_KEYFRAME_INTERVAL = 250
"""If the keyframes of a video are farther apart than this number of frames, a note suggests --unpack, because reading a
frame decodes all frames since the last keyframe."""
MAX_NAMES = 4
"""Maximum number of videos that are named in a note about all videos."""
MIN_TOLD_SECONDS = 5e-4
"""An error of the frame times is reported only if it is at least this number of seconds."""
MIN_TOLD_FRAMES = 0.5
"""Offsets below this number of frames are not reported."""


def describe_pictures(videos: Mapping[str, Video]) -> list[str]:
    """Return notes on the conversions of video frames: stretching, deinterlacing, turning upright, tone mapping of HDR
    video, and scaling down."""
    notes = []
    groups: dict[str, list[str]] = {}
    for name, video in videos.items():
        for note in (*_stretching(video.index), *video.index.notes):
            groups.setdefault(note, []).append(name)
    for note, names in groups.items():
        who = f"all {len(names)} videos" if len(names) == len(videos) > MAX_NAMES else ", ".join(names)
        notes.append(f"{who}: {note}")
    for turn in (90, 180, 270):
        names = [name for name, video in videos.items() if video.index.turn == turn]
        if names:
            # The note states the clockwise angle, because other programs describe rotation metadata by the clockwise
            # angle.
            notes.append(f"{', '.join(names)}: frames are turned {360 - turn} degrees clockwise (rotation metadata)")
    hdr = {name: video.index.transfer for name, video in videos.items() if video.index.transfer}
    if hdr:
        kinds = " and ".join(sorted(set(hdr.values())))
        peak = f", HLG peak {HLG_PEAK:g}" if "HLG" in kinds else ""
        notes.append(
            f"{', '.join(hdr)}: HDR video ({kinds}, BT.2020) is tone-mapped to sRGB: white is {REFERENCE_WHITE:g} cd/m2"
            f"{peak}, values above {KNEE:g} of white are compressed"
        )
        plain = [name for name in videos if name not in hdr]
        if plain:
            notes.append(f"{', '.join(plain)}: these videos are not HDR; colours may differ from those of HDR cameras")
    for scale in sorted({video.index.scale for video in videos.values()} - {1.0}):
        notes.append(f"frames are decoded at {scale:g} times their size")
    return notes


def _stretching(index: VideoIndex) -> list[str]:
    """Return a note if the frames of a video are stretched to square pixels or deinterlaced."""
    notes = []
    if index.aspect != 1:
        width, height = shown_size(index.stored_width, index.stored_height, index.aspect)
        notes.append(
            f"stored as {index.stored_width} x {index.stored_height} with pixels of the aspect ratio "
            f"{index.aspect.numerator}:{index.aspect.denominator}, stretched to {width} x {height}"
        )
    if index.is_interlaced:
        notes.append("interlaced: each frame is deinterlaced and shows the time of its first field")
    return notes


def describe_clock(videos: Mapping[str, Video]) -> list[str]:
    """Return notes on frame rates, unused frames, long keyframe intervals, and the largest difference between the time
    of a frame of the capture and the time of the video frame that is used for it."""
    if not videos:
        return []
    rate = next(iter(videos.values())).rate
    count = common_frames(videos)
    notes = [f"{len(videos)} videos; the capture has {format_rate(rate)} frames per second"]
    others = {name: video for name, video in videos.items() if video.drifts_from(rate)}
    if others:
        rates = ", ".join(f"{name} {format_rate(video.index.fps)}" for name, video in others.items())
        notes.append(f"videos with other rates, whose frames are picked by their times: {rates} frames per second")
    uneven = [name for name, video in videos.items() if video.index.times]
    if uneven:
        notes.append(f"{', '.join(uneven)}: uneven frame times; frames are picked by their times")
    errors = {name: video.clock_error(count) for name, video in videos.items()}
    worst = max(errors, key=lambda name: errors[name][0])
    seconds, frame = errors[worst]
    if seconds >= MIN_TOLD_SECONDS:
        notes.append(f"largest error of the frame times: {1e3 * seconds:.1f} ms ({worst}, frame {frame})")
    for name, video in videos.items():
        if video.frames_left > count:
            notes.append(f"{name}: the last {video.frames_left - count} frames are not used: other videos end earlier")
        if video.offset >= MIN_TOLD_FRAMES:
            notes.append(f"{name}: its first {video.offset:g} frames are skipped because of the offsets")
        longest = int(np.diff((0, *video.index.keyframes, video.index.frames)).max(initial=0))
        if longest > LONG_KEYFRAME_INTERVAL:
            notes.append(f"{name}: {longest} frames between keyframes: --unpack makes random access faster")
    return notes
