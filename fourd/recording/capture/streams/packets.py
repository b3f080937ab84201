"""The packets of a video: their times, positions and flags, without decoding."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

from av.container import InputContainer
from av.video.stream import VideoStream

from fourd.base.errors import UserError
from fourd.base.limits import open_regular
from fourd.recording.capture.streams.container import open_container, recorded_streams, truncated, video_stream
from fourd.recording.capture.streams.matroska import missing_bytes
from fourd.recording.capture.streams.timing import no_times

NO_TIME = -(1 << 62)
SYNC = 0x47
"""First byte of each packet of MPEG-TS (ISO/IEC 13818-1)."""
TRANSPORT_PACKETS = ((188, 0), (192, 4), (204, 0))
"""Sizes in bytes of the packets of MPEG-TS files, and the position of the sync byte in each packet."""
CHECKED_PACKETS = 5


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
        empty = end = 0
        for packet in container.demux(stream):
            end = end if packet.dts is None else max(end, packet.dts + 1)
            if not packet.size:
                # The last packet of a stream is empty and has no time. It only marks the end.
                empty += packet.dts is not None
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
        if max(end, len(packets) + empty) < declared:
            raise truncated(path, len(packets), declared)
    elif len(packets) + empty < declared:
        raise truncated(path, len(packets), declared)
    if packets.format_name == "mpegts":
        _require_whole_packets(path)
    missing = missing_bytes(path)
    if missing:
        size = path.stat().st_size
        raise UserError(
            f"{path}: expected {size + missing} bytes according to the file's header, got {size}; copy or record "
            "the video again"
        )
    return packets


def _require_whole_packets(path: Path) -> None:
    """Raise UserError if an MPEG-TS file ends within a packet, as an interrupted copy does."""
    with open_regular(path) as stream:
        head = stream.read(CHECKED_PACKETS * max(size for size, _ in TRANSPORT_PACKETS))
    for size, start in TRANSPORT_PACKETS:
        if all(byte == SYNC for byte in head[start::size]):
            rest = path.stat().st_size % size
            if rest:
                raise UserError(
                    f"{path}: expected whole packets of {size} bytes, got {rest} bytes in the last one; copy or record "
                    f"the video again, or leave out its end with: ffmpeg -i {path.name} -c copy whole-{path.name}"
                )
            return


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
