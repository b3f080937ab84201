"""Decoding of a video from its start or from a keyframe, in the order in which frames are shown.

Each decoded frame gets a label, which identifies it (see :class:`fourd.recording.capture.streams.index.VideoIndex`). If
labels are positions of packets, the decoder writes these positions into the packets' presentation times, which every
decoder of FFmpeg passes on to the frames. Frames are then identified even if the container has no usable times.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import cast

import av
from av.container import InputContainer
from av.packet import Packet
from av.video.codeccontext import VideoCodecContext
from av.video.stream import VideoStream

from fourd.recording.capture.streams.container import open_container, stream_at

SEARCHED_PACKETS = 4000
"""Maximum number of packets that are read after a seek to find the packet of a keyframe."""
NO_BYTE_SEEK = 0x8000
"""FFmpeg's flag of containers in which it cannot seek to a position in bytes (AVFMT_NO_BYTE_SEEK)."""
BYTE_SEEK_FORMATS = ("mpegts", "mpeg")
"""Containers in which seeking to a time is not exact, but seeking to a position in bytes is."""
ALPHA_DECODERS = {"vp8": "libvpx", "vp9": "libvpx-vp9"}
"""Decoders of codecs whose alpha channel FFmpeg's own decoder leaves out."""


@dataclass(frozen=True)
class Decoded:
    """A decoded frame.

    Attributes:
        label: label of the frame.
        frame: the frame.
        is_key: whether the frame refers to no others, and no later frame refers to frames before it.
    """

    label: int
    frame: av.VideoFrame
    is_key: bool


@dataclass(frozen=True)
class Entry:
    """A keyframe at which decoding can start.

    Attributes:
        label: label of the keyframe.
        time: the decoding time in ticks, or the presentation time if labels are times.
        position: position of the packet in bytes.
        size: size of the packet in bytes.
    """

    label: int
    time: int
    position: int
    size: int


class Decoder:
    """Decodes a video stream from its start or from an entry. Close the decoder after use."""

    def __init__(self, path: Path, stream: int, threads: int, *, by_packets: bool, is_strict: bool) -> None:
        """Create a decoder.

        Args:
            path: the video.
            stream: number of the stream in the container.
            threads: number of threads, or 0 if FFmpeg chooses the number.
            by_packets: whether labels are positions of packets instead of times.
            is_strict: whether the decoder raises an error for damaged data that it would otherwise guess.
        """
        self._path, self._stream_index, self._threads = path, stream, threads
        self._by_packets, self._is_strict = by_packets, is_strict
        self._container: InputContainer | None = None
        self._context: VideoCodecContext | None = None

    def close(self) -> None:
        """Close the file."""
        if self._container is not None:
            self._container.close()
            self._container = self._context = None

    def from_start(self) -> Iterator[Decoded]:
        """Decode the video from its first packet. The file is opened again, so that nothing depends on earlier reads.

        Packets before the first frame may be undecodable. Raises av.FFmpegError for a later packet that cannot be
        decoded.
        """
        self.close()
        stream = self._open()
        return self._decode(stream, self._packets(stream))

    def from_entry(self, entry: Entry) -> Iterator[Decoded] | None:
        """Decode the video from a keyframe. Return None if the seek does not reach the keyframe's packet.

        The first frames can be frames that are shown before the keyframe. They may be damaged, since frames are missing
        to which they refer.
        """
        stream = self._open()
        assert self._container is not None
        assert self._context is not None
        self._context.flush_buffers()
        if not self._by_packets:
            self._container.seek(entry.time, stream=stream)
            return self._decode(stream, self._packets(stream))
        if self._container.format.name in BYTE_SEEK_FORMATS:
            self._container.seek(entry.position, stream=stream, unsupported_byte_offset=True)
        else:
            self._container.seek(entry.time, stream=stream)
        packets = self._packets(stream)
        for count, packet in enumerate(packets):
            if (packet.pos, packet.size) == (entry.position, entry.size):
                return self._decode(stream, chain([packet], packets), entry.label)
            if count > SEARCHED_PACKETS or (packet.pos or 0) > entry.position:
                break
        return None

    def _open(self) -> VideoStream:
        if self._container is None:
            self._container = open_container(self._path)
        stream = stream_at(self._path, self._container, self._stream_index)
        if self._context is None:
            self._context = alpha_context(stream) or stream.codec_context
            self._context.thread_type = "AUTO"
            self._context.thread_count = self._threads
            if self._is_strict:
                self._context.options = {"err_detect": "explode"}
        return stream

    def _packets(self, stream: VideoStream) -> Iterator[Packet]:
        """Yield the packets of a stream that are not empty. FFmpeg would take an empty packet for the end."""
        assert self._container is not None
        return (packet for packet in self._container.demux(stream) if packet.size)

    def _decode(self, stream: VideoStream, packets: Iterator[Packet], label: int = 0) -> Iterator[Decoded]:
        context = self._context
        assert context is not None
        # The decoders of ALPHA_DECODERS do not mark keyframes.
        keys: set[int] | None = None if context is stream.codec_context else set()
        has_frames = False
        for number, packet in enumerate(chain(packets, [None]), label):
            if packet is not None and self._by_packets:
                packet.pts = number
            if packet is not None and packet.is_keyframe and packet.pts is not None and keys is not None:
                keys.add(packet.pts)
            try:
                frames = context.decode(packet)
            except av.EOFError:
                return
            except av.FFmpegError:
                # A recording that is cut from a longer one starts with packets that refer to missing frames.
                if has_frames:
                    raise
                continue
            has_frames |= bool(frames)
            for frame in frames:
                if frame.pts is not None:
                    yield Decoded(frame.pts, frame, frame.key_frame if keys is None else frame.pts in keys)


def alpha_context(stream: VideoStream) -> VideoCodecContext | None:
    """Return a decoder that also decodes the alpha channel of a WebM video, or None if FFmpeg's own decoder does so or
    there is no alpha channel."""
    tags = {name.lower(): value for name, value in stream.metadata.items()}
    name = ALPHA_DECODERS.get(stream.codec_context.codec.canonical_name)
    if name is None or tags.get("alpha_mode") != "1":
        return None
    return cast(VideoCodecContext, av.CodecContext.create(name, "r"))
