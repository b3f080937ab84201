"""The packets of a video: their times, positions and flags, without decoding."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

from av.container import InputContainer
from av.video.stream import VideoStream

from fourd.capture.streams.container import open_container, recorded_streams, truncated, video_stream
from fourd.capture.streams.matroska import missing_bytes
from fourd.capture.streams.timing import no_times
from fourd.errors import UserError

NO_TIME = -(1 << 62)


@dataclass(frozen=True)
class Packets:
    """The packets of a video stream in the order of the file, without empty ones.

    Times are in ticks, and NO_TIME if they are missing. Positions are in bytes, and negative if they are not known.
    ``aspect`` is the width of a pixel divided by its height, and ``rate`` the frame rate of the header in 1/s or 0.
    """

    format_name: str
    codec: str
    is_intra_only: bool
    stream: int
    tick: Fraction
    aspect: Fraction
    rate: Fraction
    notes: tuple[str, ...]
    times: array[int] = field(default_factory=lambda: array("q"))
    decode_times: array[int] = field(default_factory=lambda: array("q"))
    positions: array[int] = field(default_factory=lambda: array("q"))
    sizes: array[int] = field(default_factory=lambda: array("q"))
    keys: bytearray = field(default_factory=bytearray)
    discarded: bytearray = field(default_factory=bytearray)
    damaged: bytearray = field(default_factory=bytearray)

    def __len__(self) -> int:
        return len(self.times)


def read_packets(path: Path) -> Packets:
    """Read the packets of the video stream with the most pixels.

    Raises:
        UserError: if the file has no video stream, no frames, or fewer frames or bytes than its header declares.
        av.FFmpegError, OSError: if the file is damaged.
    """
    with open_container(path) as container:
        stream = video_stream(path, container)
        if stream.time_base is None:
            raise no_times(path, "frames without times")
        packets = _described(container, stream)
        empty = 0
        for packet in container.demux(stream):
            if not packet.size:
                empty += 1
                continue
            packets.times.append(NO_TIME if packet.pts is None else packet.pts)
            packets.decode_times.append(NO_TIME if packet.dts is None else packet.dts)
            packets.positions.append(-1 if packet.pos is None else packet.pos)
            packets.sizes.append(packet.size)
            packets.keys.append(packet.is_keyframe)
            packets.discarded.append(packet.is_discard)
            packets.damaged.append(packet.is_corrupt)
        declared = stream.frames
        if packets.format_name.startswith("mov") and declared:
            # FFmpeg skips packets that the edit list of the file cuts off.
            declared = min(declared, len(stream.index_entries))
    if not packets:
        raise UserError(f"{path}: expected a video with frames, got no frames; copy the file again")
    if packets.format_name == "avi":
        # The header of an AVI file also counts dropped frames, which are stored as empty packets.
        if max(packets.decode_times[-1] + 1, len(packets) + empty) < declared - 1:
            raise truncated(path, len(packets), declared)
    elif len(packets) < declared:
        raise truncated(path, len(packets), declared)
    missing = missing_bytes(path)
    if missing:
        size = path.stat().st_size
        raise UserError(
            f"{path}: expected {size + missing} bytes according to the file's header, got {size}; copy or record "
            "the video again"
        )
    return packets


def _described(container: InputContainer, stream: VideoStream) -> Packets:
    others = recorded_streams(container)[1:]
    notes: tuple[str, ...] = ()
    if others:
        sizes = ", ".join(f"{other.width} x {other.height}" for other in others)
        notes = (
            f"the largest of {1 + len(others)} video streams is used ({stream.width} x {stream.height}; others: "
            f"{sizes})",
        )
    context = stream.codec_context
    assert stream.time_base is not None
    return Packets(
        container.format.name,
        context.codec.canonical_name,
        context.codec.intra_only,
        stream.index,
        stream.time_base,
        stream.sample_aspect_ratio or Fraction(1),
        stream.average_rate or stream.guessed_rate or Fraction(0),
        notes,
    )
