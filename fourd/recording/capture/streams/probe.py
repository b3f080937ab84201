"""Creation of a video's index from its packets, or from its decoded frames where the packets cannot be trusted."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import replace
from itertools import islice
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.recording.capture.streams.appearance import Appearance, check_size, look_at
from fourd.recording.capture.streams.decoder import Decoded, Decoder
from fourd.recording.capture.streams.frames import FrameReader
from fourd.recording.capture.streams.index import VideoIndex
from fourd.recording.capture.streams.interlacing import CombCounter
from fourd.recording.capture.streams.packets import NO_TIME, Packets
from fourd.recording.capture.streams.timing import frame_rate, no_times

PROBE_THREADS = 2
"""Number of threads that decode frames for the index. It is small, because each thread keeps several frames in
memory."""
TIMED_CONTAINERS = ("mov", "matroska")
"""Containers that store the presentation time of every frame, and the places of the keyframes."""
TIMED_CODECS = ("h264", "hevc", "vp9", "av1")
"""Codecs with frames that refer to others, of which each packet is one frame, if the container stores times."""
FRAME_CODECS = (*TIMED_CODECS, "mpeg2video", "mpeg4")
"""Codecs of which each packet is one frame, except packets of at most MAX_EMPTY_BYTES and the fields of interlaced
video."""
MAX_EMPTY_BYTES = 64
MAX_LEADING = 16
"""Number of packets after the first keyframe that may contain frames that are shown before it and cannot be decoded."""
STRICT_CODECS = ("hevc", "mjpeg")
"""Codecs whose decoders guess damaged data silently, unless an option lets them report it."""
STRICT_FRAMES = 8
UNCHECKED_CODECS = ("hevc",)
"""Codecs of which damage is also inferred from packets that MPEG-TS marks as damaged. Decoders of the other codecs find
it themselves, and packets are also marked where two whole recordings are joined."""
INTRA_CONTAINERS = (*TIMED_CONTAINERS, "avi")
"""Containers in which the times identify the frames of codecs whose frames refer to no others."""
CHECKED_FRAMES = 32
"""Number of frames at the start of a video whose decoded times are compared with the times of the packets."""
CHECKED_KEYFRAMES, TRIED_KEYFRAMES = 3, 16
MAX_SHARED_FRAMES = 3
"""Maximum deviation of known times from the rate of the header, in frames, if several frames share one time."""
SAMPLES = 48
"""Number of places at which frames of interlaced video are measured."""


def index_by_times(path: Path, packets: Packets) -> VideoIndex | None:
    """Create the index of a video from the times of its packets, and check it by decoding some frames.

    Returns:
        The index, or None if the times do not identify the frames; see :func:`index_by_decoding`.

    Raises:
        UserError: if the video cannot be used.
    """
    if not _has_trusted_times(packets):
        return None
    shown = [number for number in range(len(packets)) if not packets.discarded[number]]
    shown.sort(key=packets.times.__getitem__)
    times = np.array([packets.times[number] for number in shown], np.int64)
    if len(times) < 2 or np.diff(times).min() <= 0:
        return None
    keyframes = tuple(number for number, packet in enumerate(shown) if packets.keys[packet])
    try:
        first = _first_frames(path, packets, 1, is_strict=False)
    except av.FFmpegError:
        return None
    if not first:
        raise _no_frame(path)
    look = look_at(path, first[0].frame, packets.aspect)
    index = _make_index(path, packets, times, keyframes, look)
    index = replace(index, is_strict=_can_be_strict(path, packets))
    counter = CombCounter()
    reader = FrameReader(path, index, PROBE_THREADS)
    try:
        if not _is_confirmed(path, index, reader):
            return None
        if look.is_marked:
            for place in range(SAMPLES):
                earlier = place * (len(times) - 1) // SAMPLES
                counter.restart()
                for number in (earlier, earlier + 1):
                    counter.add(reader.frame(number))
    finally:
        reader.close()
    return _with_fields(index, counter)


def _has_trusted_times(packets: Packets) -> bool:
    is_timed = packets.format_name.startswith(TIMED_CONTAINERS) and packets.codec in TIMED_CODECS
    has_times = NO_TIME not in packets.times
    return has_times and (is_timed or (packets.is_intra_only and packets.format_name.startswith(INTRA_CONTAINERS)))


def _first_frames(path: Path, packets: Packets, count: int, *, is_strict: bool) -> list[Decoded]:
    """Decode the first frames of a video; the labels are positions of packets."""
    decoder = Decoder(path, packets.stream, PROBE_THREADS, by_packets=True, is_strict=is_strict)
    try:
        return list(islice(decoder.from_start(), count))
    finally:
        decoder.close()


def _can_be_strict(path: Path, packets: Packets) -> bool:
    """Return whether a decoder that can report damaged data finds none at the start of the video. Some cameras write
    data that it reports although the pictures are whole."""
    if packets.codec not in STRICT_CODECS:
        return False
    try:
        strict, lenient = (_first_frames(path, packets, STRICT_FRAMES, is_strict=each) for each in (True, False))
    except av.FFmpegError:
        return False
    return [each.label for each in strict] == [each.label for each in lenient]


def _no_frame(path: Path) -> UserError:
    return UserError(f"{path}: expected a video with frames, got no frame that can be decoded; copy the file again")


def _is_confirmed(path: Path, index: VideoIndex, reader: FrameReader) -> bool:
    """Return whether decoding gives the frames that the index expects: at the start, at the end, and after seeks."""
    decoder = Decoder(path, index.stream, PROBE_THREADS, by_packets=False, is_strict=index.is_strict)
    try:
        for expected, each in zip(range(min(CHECKED_FRAMES, index.frames)), decoder.from_start(), strict=False):
            if index.number(each.label) != expected or each.frame.is_corrupt:
                return False
        if len(_entered(reader, index, CHECKED_KEYFRAMES)) < min(CHECKED_KEYFRAMES, len(index.keyframes)):
            return False
        reader.frame(index.frames - 1)
    except (av.FFmpegError, UserError):
        # Decoding all frames finds the damaged one.
        return False
    finally:
        decoder.close()
    return True


def _entered(reader: FrameReader, index: VideoIndex, count: int) -> list[int]:
    """Try to start decoding at ``count`` evenly spaced keyframes. Return the places of those in the list of keyframes
    at which this works."""
    if not index.keyframes:
        return []
    last = len(index.keyframes) - 1
    places = sorted({round(at) for at in np.linspace(0, last, count)})
    return [at for at in places if reader.can_enter(index.keyframes[at])]


def index_by_decoding(path: Path, packets: Packets) -> VideoIndex:
    """Create the index of a video by decoding all its frames.

    Frames before the first keyframe are left out, because they refer to frames that are not in the file.

    Raises:
        UserError: if the video is damaged or cannot be used.
    """
    is_strict = _can_be_strict(path, packets)
    decoder = Decoder(path, packets.stream, PROBE_THREADS, by_packets=True, is_strict=is_strict)
    labels, keys, counter, look, has_fields = array("q"), bytearray(), CombCounter(), None, False
    stride = max(len(packets) // SAMPLES, 2)
    try:
        for each in decoder.from_start():
            frame = each.frame
            is_key = each.is_key or (packets.codec not in FRAME_CODECS and bool(packets.keys[each.label]))
            if not labels and (frame.is_corrupt or not is_key):
                continue
            if frame.is_corrupt or (packets.codec in UNCHECKED_CODECS and packets.damaged[each.label]):
                raise _broken(path, len(labels))
            look = look or look_at(path, frame, packets.aspect)
            check_size(path, frame, len(labels), look.stored_size)
            if len(labels) % stride < 2:
                if len(labels) % stride == 0:
                    counter.restart()
                counter.add(frame)
            has_fields |= bool(frame.interlaced_frame)
            labels.append(each.label)
            keys.append(each.is_key)
    except av.FFmpegError as error:
        raise _broken(path, len(labels)) from error
    finally:
        decoder.close()
    if look is None:
        raise _no_frame(path)
    if not has_fields:
        _require_all_frames(path, packets, labels)
    index = _make_index(path, packets, _shown_times(path, packets, labels), (), look)
    index = _with_usable_entries(path, _with_entries(replace(index, is_strict=is_strict), packets, labels, keys))
    return _with_fields(index, counter)


def _require_all_frames(path: Path, packets: Packets, labels: array[int]) -> None:
    """Raise UserError if a packet after the first frame contains a frame that is not decoded.

    Packets before the first frame in the order of the file, and those that the container discards, are not checked.
    """
    decoded = set(labels)
    for packet in range(min(labels), len(packets)):
        is_frame = packets.codec in FRAME_CODECS and packets.sizes[packet] > MAX_EMPTY_BYTES
        if is_frame and packet not in decoded and not packets.discarded[packet]:
            if packet < labels[0] + MAX_LEADING:
                continue
            raise _broken(path, sum(label < packet for label in labels))


def _broken(path: Path, number: int) -> UserError:
    return UserError(
        f"{path}: expected frame {number} to be whole, got damaged data; copy or record the video again, or repair it "
        f"with: ffmpeg -i {path.name} -crf 12 repaired-{path.stem}.mp4"
    )


def _shown_times(path: Path, packets: Packets, labels: array[int]) -> NDArray[np.int64]:
    """Return the ascending times in ticks of decoded frames, which are listed in the order in which they are shown.

    The result are the presentation times, if all frames have them in this order, or else the decoding times in
    ascending order, which differ from them by a constant. If some frames have no time of their own, their times are
    interpolated.
    """
    times = np.array([packets.times[label] for label in labels], np.int64)
    decoded = np.sort(np.array([packets.decode_times[label] for label in labels], np.int64))
    # AVI files store no presentation times. Those of FFmpeg are guesses.
    for found in (decoded,) if packets.format_name == "avi" else (times, decoded):
        if len(found) < 2 or (NO_TIME not in found and np.diff(found).min() > 0):
            return found
    return _completed(path, packets, times)


def _completed(path: Path, packets: Packets, times: NDArray[np.int64]) -> NDArray[np.int64]:
    """Complete the times of frames of which some are missing, as in MPEG program streams, where several small frames
    share one time. The frame rate of the header is used if it agrees with the known times."""
    has_time = times != NO_TIME
    has_time[1:] &= times[1:] != times[:-1]
    known = np.flatnonzero(has_time)
    if not len(known) or (len(known) > 1 and np.diff(times[known]).min() <= 0):
        raise no_times(path, f"{len(times)} frames of which {len(known)} have a time of their own")
    numbers = np.arange(len(times))
    if packets.rate > 0:
        exact = numbers * float(1 / (packets.rate * packets.tick))
        late = times[known] - exact[known]
        if np.abs(late - np.median(late)).max() <= MAX_SHARED_FRAMES * exact[1]:
            return np.rint(exact + np.median(late)).astype(np.int64)
    filled = np.rint(np.interp(numbers, known, times[known])).astype(np.int64)
    if np.diff(filled).min() <= 0:
        raise no_times(path, f"{len(times)} frames of which {len(known)} have a time of their own")
    return filled


def _with_entries(index: VideoIndex, packets: Packets, labels: array[int], keys: bytearray) -> VideoIndex:
    """Add the labels, and the keyframes from which decoding can start, to an index."""
    places = list(zip(packets.positions, packets.sizes, strict=True))
    known = Counter(places)
    found = [
        number
        for number, label in enumerate(labels)
        if keys[number] and packets.keys[label] and packets.positions[label] >= 0 and known[places[label]] == 1
    ]
    chosen = [labels[number] for number in found]
    order = tuple(label - number for number, label in enumerate(labels))
    return replace(
        index,
        by_packets=True,
        keyframes=tuple(found),
        order=order if any(order) else (),
        positions=tuple(packets.positions[label] for label in chosen),
        sizes=tuple(packets.sizes[label] for label in chosen),
        decode_times=tuple(_seek_time(packets, label) for label in chosen),
    )


def _with_usable_entries(path: Path, index: VideoIndex) -> VideoIndex:
    """Try to start decoding at some of the keyframes. If one is unusable, keep only those that are known to work."""
    reader = FrameReader(path, index, PROBE_THREADS)
    try:
        usable = _entered(reader, index, TRIED_KEYFRAMES)
    finally:
        reader.close()
    if len(usable) == min(TRIED_KEYFRAMES, len(index.keyframes)):
        return index
    return replace(
        index,
        keyframes=tuple(index.keyframes[at] for at in usable),
        positions=tuple(index.positions[at] for at in usable),
        sizes=tuple(index.sizes[at] for at in usable),
        decode_times=tuple(index.decode_times[at] for at in usable),
    )


def _seek_time(packets: Packets, label: int) -> int:
    time = packets.decode_times[label]
    return packets.times[label] if time == NO_TIME else time


def _make_index(
    path: Path, packets: Packets, times: NDArray[np.int64], keyframes: tuple[int, ...], look: Appearance
) -> VideoIndex:
    if len(times) == 1:
        raise UserError(
            f"{path}: expected a video of at least 2 frames, got 1; record the video again, or put this frame as "
            f"an image into the folder {path.stem}/"
        )
    fps, is_even = frame_rate(path, times, packets.tick, packets.rate)
    width, height = look.size
    return VideoIndex(
        width,
        height,
        len(times),
        int(times[0]) * packets.tick,
        fps,
        keyframes,
        look.turn,
        look.transfer,
        tick=packets.tick,
        times=() if is_even else tuple((times - times[0]).tolist()),
        stored_width=look.stored_size[0],
        stored_height=look.stored_size[1],
        aspect=look.aspect,
        stream=packets.stream,
        notes=packets.notes + look.notes,
    )


def _with_fields(index: VideoIndex, counter: CombCounter) -> VideoIndex:
    notes = index.notes
    if counter.is_progressive:
        notes += (
            "marked as interlaced, but moving parts of its frames show one time each, so they are used as they are",
        )
    return replace(index, is_interlaced=counter.is_interlaced, notes=notes)
