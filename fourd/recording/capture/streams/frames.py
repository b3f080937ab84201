"""Access to the decoded frames of a video by number."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import av

from fourd.base.errors import UserError
from fourd.recording.capture.streams.appearance import check_size
from fourd.recording.capture.streams.container import damaged
from fourd.recording.capture.streams.decoder import Decoded, Decoder, Entry
from fourd.recording.capture.streams.index import VideoIndex

MAX_TRIES = 2
"""Number of keyframes from which a frame is decoded before it counts as damaged. A second keyframe helps if a frame
refers to frames before the first one."""
RECENT = 3
"""Number of decoded frames that are kept. Deinterlacing needs the frame before and the frame after."""


class FrameReader:
    """Decodes frames by number.

    Reading frames in ascending order decodes each frame once. In other orders, the reader seeks to the last keyframe at
    or before the requested frame. It uses the keyframe only if exactly this keyframe comes out of the decoder;
    otherwise it tries earlier keyframes, and in the end the start of the video. Frames that are shown before the
    keyframe are dropped, because they may refer to missing frames.
    """

    def __init__(self, path: Path, index: VideoIndex, threads: int = 0) -> None:
        """Create a reader that decodes with ``threads`` threads. If ``threads`` is 0, FFmpeg chooses the number."""
        self._path, self._index = path, index
        self._decoder = Decoder(path, index.stream, threads, by_packets=index.by_packets, is_strict=index.is_strict)
        self._decoded: Iterator[Decoded] | None = None
        self._next = 0
        self._recent: dict[int, av.VideoFrame] = {}
        self._unusable: set[int] = set()

    def close(self) -> None:
        """Close the file; the next read opens it again."""
        self._decoded = None
        self._recent.clear()
        self._decoder.close()

    def frame(self, number: int) -> av.VideoFrame:
        """Decode the frame with a number, from 0 to ``index.frames`` - 1.

        Raises:
            UserError: if the frame is damaged or missing, or has another size than frame 0.
        """
        if number not in self._recent:
            frame = self._read(number)
            check_size(self._path, frame, number, (self._index.stored_width, self._index.stored_height))
        return self._recent[number]

    def can_enter(self, keyframe: int) -> bool:
        """Return whether decoding can start at the keyframe with this number in ``index.keyframes``."""
        return self._enter(keyframe)

    def _read(self, number: int) -> av.VideoFrame:
        got = "no such frame"
        if self._is_next(number):
            try:
                found = self._decode_until(number)
            except av.FFmpegError as error:
                found, got = None, _reason(error)
            if found is not None:
                return found
        tries = 0
        for start in self._starts(number):
            try:
                if not self._enter(start):
                    continue
                found = self._decode_until(number)
            except av.FFmpegError as error:
                found, got = None, _reason(error)
            except OSError as error:
                raise damaged(self._path, error) from error
            if found is not None:
                return found
            tries += 1
            if tries == MAX_TRIES:
                break
        self._decoded = None
        raise UserError(
            f"{self._path}: expected frame {number} to be whole, got {got}; copy or record the video again, or repair "
            f"it with: ffmpeg -i {self._path.name} -crf 12 repaired-{self._path.stem}.mp4"
        )

    def _is_next(self, number: int) -> bool:
        """Return whether decoding on reaches the frame without decoding more frames than after a seek."""
        if self._decoded is None or self._next > number:
            return False
        usable = next((key for key in self._usable_keyframes(number)), 0)
        return usable <= self._next

    def _usable_keyframes(self, number: int) -> Iterator[int]:
        """Yield the numbers of the keyframes at or before a frame, the last first."""
        keyframes, count = self._index.keyframes, self._index.keyframe_count(number)
        return (keyframes[at] for at in range(count - 1, -1, -1) if keyframes[at] not in self._unusable)

    def _starts(self, number: int) -> Iterator[int | None]:
        """Yield the keyframes from which a frame can be decoded, the last first and then in growing steps, and None for
        the start of the video."""
        skipped, step = 0, 1
        for count, key in enumerate(self._usable_keyframes(number)):
            if count == skipped:
                yield key
                skipped, step = skipped + step, 2 * step
        yield None

    def _enter(self, keyframe: int | None) -> bool:
        """Start decoding at a keyframe, or at the start of the video. Return False if the keyframe is unusable."""
        self._recent.clear()
        self._next = 0 if keyframe is None else keyframe
        if keyframe is None:
            self._decoded = self._decoder.from_start()
            return True
        self._decoded = None
        try:
            decoded = self._decoder.from_entry(self._entry(keyframe))
            for each in decoded or ():
                number = self._index.number(each.label)
                if number is None or number < keyframe:
                    continue
                if number == keyframe and each.is_key and not each.frame.is_corrupt:
                    assert decoded is not None
                    self._decoded = decoded
                    self._keep(number, each.frame)
                    return True
                break
        except av.FFmpegError:
            pass
        self._unusable.add(keyframe)
        return False

    def _entry(self, keyframe: int) -> Entry:
        index = self._index
        if not index.by_packets:
            return Entry(0, round(index.time(keyframe) / index.tick), 0, 0)
        at = index.keyframe_count(keyframe) - 1
        return Entry(index.label(keyframe), index.decode_times[at], index.positions[at], index.sizes[at])

    def _decode_until(self, wanted: int) -> av.VideoFrame | None:
        """Decode frames up to the frame ``wanted``, and return this frame, or None if it is missing or damaged."""
        if wanted in self._recent:
            return self._recent[wanted]
        for each in self._decoded or ():
            number = self._index.number(each.label)
            if number is None or number < self._next:
                continue
            self._keep(number, each.frame)
            if number >= wanted:
                return each.frame if number == wanted and not each.frame.is_corrupt else None
        return None

    def _keep(self, number: int, frame: av.VideoFrame) -> None:
        self._recent[number] = frame
        self._recent.pop(number - RECENT, None)
        self._next = number + 1


def _reason(error: Exception) -> str:
    return f"'{getattr(error, 'strerror', None) or error}'"
