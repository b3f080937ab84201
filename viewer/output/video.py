"""Writes videos image by image: MP4 (H.264), WebM (VP9) and GIF files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.filter
import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.files import atomic_path, remove_unfinished_file
from fourd.recording.soundtrack.ogg import RATE
from fourd.recording.soundtrack.opus import LAYOUTS
from fourd.viewer.output.sound import VideoSound

# The value 1 stands for BT.709 as the matrix, the primaries and the transfer function (ITU-T H.273). As FFmpeg's
# color_range, it stands for limited range.
_BT709 = 1
SOUND_BIT_RATE = 96_000
"""Bits per second of each channel of sound."""
_GIF_MAX_FPS = 50
"""GIF files store times in hundredths of a second, and players slow down images that are shown for less than two."""


@dataclass(frozen=True)
class _VideoFormat:
    """A kind of video file.

    Attributes:
        title: name of the codec in error messages.
        container: FFmpeg's name of the container.
        encoders: encoders, of which the first one that PyAV has is used.
        pixels: pixel format of the encoded images.
        sound: encoder of the sound, or None if the file has no sound. Every player of MP4 files plays AAC.
    """

    title: str
    container: str
    encoders: tuple[str, ...]
    pixels: str = "yuv420p"
    sound: str | None = None


_FORMATS = {
    ".mp4": _VideoFormat("H.264", "mp4", ("libx264", "libopenh264", "h264_videotoolbox", "h264"), sound="aac"),
    ".webm": _VideoFormat("VP9", "webm", ("libvpx-vp9",), sound="libopus"),
    ".gif": _VideoFormat("GIF", "gif", ("gif",), "pal8"),
}
VIDEO_SUFFIXES = tuple(_FORMATS)
"""Suffixes of the video files that can be written."""


def require_video(path: Path, fps: float | None = None) -> None:
    """Check the name of a video to be written, before its images are rendered.

    Raises:
        UserError: if the name does not end in one of VIDEO_SUFFIXES (in upper or lower case), if there is a folder of
            this name, or if a GIF cannot have ``fps`` images per second.
    """
    suffix, listed = path.suffix.lower(), ", ".join(VIDEO_SUFFIXES)
    if suffix not in _FORMATS:
        got = f"the suffix {path.suffix}" if path.suffix else "no suffix"
        raise UserError(f"{path}: expected a video that ends in {listed}, got {got}; write {path.stem or 'file'}.mp4")
    if path.is_dir():
        raise UserError(f"{path}: expected a video file, got a folder of this name; remove it or choose another name")
    if suffix == ".gif" and fps is not None and fps > _GIF_MAX_FPS:
        raise UserError(
            f"{path}: expected at most {_GIF_MAX_FPS} images per second for a GIF, got {fps:g}; add --fps "
            f"{_GIF_MAX_FPS}, or write an .mp4 or a .webm file"
        )


def is_video(path: Path) -> bool:
    """Return whether an output is a video. Otherwise, it is a folder: a name without a suffix, or an existing folder.

    Raises:
        UserError: if the name has another suffix; see also :func:`require_video`.
    """
    if path.suffix.lower() in _FORMATS:
        require_video(path)
        return True
    if path.suffix and not path.is_dir():
        raise UserError(
            f"{path}: expected a folder, or a video that ends in {', '.join(VIDEO_SUFFIXES)}, got the suffix "
            f"{path.suffix}; change the suffix, or create the folder first if you want a folder of this name"
        )
    if path.exists() and not path.is_dir():
        raise UserError(f"{path}: expected a folder, got a file of this name; choose another name")
    return False


def write_video(
    path: Path | str,
    images: Iterable[NDArray[Any]],
    fps: float,
    *,
    quality: int = 18,
    sound: VideoSound | None = None,
) -> int:
    """Write images as a video. The suffix of ``path`` determines the format:

    - .mp4: H.264, yuv420p, BT.709, which every player opens
    - .webm: VP9, yuv420p, BT.709
    - .gif: a GIF that repeats, with 256 colours in each image

    Args:
        path: the file, which is written atomically. If ``images`` raises an exception, no file is written.
        images: RGB images (H, W, 3) of one size, as uint8 or as float in [0, 1]. They are read one by one, so
            ``images`` can be a generator, and memory use does not grow with their number. If a side is odd, the last
            row or column is repeated in MP4 and WebM files, because yuv420p needs even sides.
        fps: images per second, above 0. At most 50 for a GIF.
        quality: constant rate factor (CRF) of x264, from 0 (lossless) to 51. A smaller CRF gives better quality and a
            larger file. VP9 gets the CRF of about the same quality. Other encoders ignore it.
        sound: the sound of the video: AAC in MP4 files, Opus in WebM files. GIF files have no sound.

    Returns:
        The number of images written.

    Raises:
        UserError: when the name has another suffix, when there is no encoder, or when ``images`` is empty.
        ValueError: when an image does not have the shape of the first image.
    """
    path = Path(path)
    if not fps > 0:
        raise ValueError(f"fps: expected more than 0, got {fps}")
    require_video(path, fps)
    kind = _FORMATS[path.suffix.lower()]
    encoder, rate = _find_encoder(path, kind), Fraction(fps).limit_denominator(100_000)
    remove_unfinished_file(path)
    options = {"movflags": "+faststart"} if kind.container == "mp4" else {}
    count = 0
    stream: Any = None
    track: _SoundTrack | None = None
    with (
        atomic_path(path) as temporary,
        av.open(str(temporary), "w", format=kind.container, options=options) as container,
    ):
        for frame in _frames(images, kind, rate):
            if stream is None:
                stream = _add_stream(container, encoder, kind, frame, rate, quality)
                track = None if sound is None or kind.sound is None else _SoundTrack(container, kind.sound, sound)
            _encode(container, stream, frame)
            count += 1
            if track is not None:
                track.write_until(count / rate)
        if stream is None:
            raise UserError(f"{path}: expected at least one image for a video, got none")
        _encode(container, stream, None)
        if track is not None:
            track.finish()
    return count


def _find_encoder(path: Path, kind: _VideoFormat) -> str:
    for name in kind.encoders:
        if name in av.codecs_available:
            try:
                av.Codec(name, "w")
            except ValueError:
                continue
            return name
    raise UserError(
        f"{path}: expected FFmpeg with an encoder for {kind.title} in PyAV, got none; "
        "pip install --force-reinstall --only-binary=:all: av, or give a folder as output to get PNG images"
    )


def _frames(images: Iterable[NDArray[Any]], kind: _VideoFormat, rate: Fraction) -> Iterator[Any]:
    """Convert the images to frames with the pixels of the format and with their times."""
    shape: tuple[int, ...] = ()
    palette: _Palette | None = None
    for count, image in enumerate(images):
        if count == 0:
            shape = image.shape
            if len(shape) != 3 or shape[2] != 3 or min(shape) < 1:
                raise ValueError(f"images: expected (H, W, 3), got {shape}")
            palette = _Palette(shape[1], shape[0]) if kind.pixels == "pal8" else None
        if image.shape != shape:
            raise ValueError(f"images: expected {shape} like the first image, got {image.shape} at index {count}")
        frame = _to_yuv(image) if palette is None else palette.apply(_to_bytes(image))
        frame.pts, frame.time_base = count, 1 / rate
        yield frame


def _add_stream(container: Any, encoder: str, kind: _VideoFormat, frame: Any, rate: Fraction, quality: int) -> Any:
    options = {}
    if encoder == "libx264":
        options = {"crf": str(quality), "preset": "medium"}
    elif encoder == "libvpx-vp9":
        # The CRF of VP9 goes from 0 to 63, and 30 looks about like 21 of x264. The bit rate 0 makes it the only limit.
        crf = min(63, round(quality * 30 / 21))
        options = {"crf": str(crf), "b": "0", "deadline": "good", "cpu-used": "4", "row-mt": "1"}
    elif encoder == "gif":
        # The encoder compares palette indices of consecutive images to store only what has changed. This would be
        # wrong here, because each image has its own palette.
        options = {"gifflags": "-offsetting-transdiff"}
    stream = container.add_stream(encoder, rate=rate, options=options)
    stream.height, stream.width, stream.pix_fmt = frame.height, frame.width, kind.pixels
    context = stream.codec_context
    if kind.pixels == "yuv420p":
        context.color_range = context.colorspace = context.color_primaries = context.color_trc = _BT709
    if encoder == "libvpx-vp9":
        context.bit_rate = 0
    return stream


class _SoundTrack:
    """Encodes the sound of a video along with its images, so that the container keeps few packets in memory."""

    def __init__(self, container: Any, encoder: str, sound: VideoSound) -> None:
        self._container = container
        self._stream = container.add_stream(encoder, rate=RATE, layout=LAYOUTS[sound.channels])
        self._stream.bit_rate = SOUND_BIT_RATE * sound.channels
        self._layout = LAYOUTS[sound.channels]
        self._blocks = sound.blocks()
        self._position = 0

    def write_until(self, seconds: Fraction) -> None:
        """Encode sound until the time ``seconds`` of the video."""
        while self._position < seconds * RATE:
            block = next(self._blocks, None)
            if block is None:
                return
            frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(block), format="fltp", layout=self._layout)
            frame.sample_rate, frame.pts, frame.time_base = RATE, self._position, Fraction(1, RATE)
            _encode(self._container, self._stream, frame)
            self._position += block.shape[1]

    def finish(self) -> None:
        """Encode what is left in the encoder."""
        _encode(self._container, self._stream, None)


def _to_bytes(image: NDArray[Any]) -> NDArray[np.uint8]:
    if image.dtype != np.uint8:
        image = np.round(np.nan_to_num(np.clip(image, 0, 1)) * 255).astype(np.uint8)
    return np.ascontiguousarray(image)


def _to_yuv(image: NDArray[Any]) -> Any:
    rgb = _to_bytes(image)
    height, width = rgb.shape[:2]
    if height % 2 or width % 2:
        rgb = np.pad(rgb, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return av.VideoFrame.from_ndarray(rgb, format="rgb24").reformat(format="yuv420p", dst_colorspace="ITU709")


class _Palette:
    """Reduces each image to the 256 colours that fit it best, with FFmpeg's filters palettegen and paletteuse."""

    def __init__(self, width: int, height: int) -> None:
        graph = av.filter.Graph()
        self._source = graph.add_buffer(
            width=width, height=height, format=av.VideoFormat("rgb24"), time_base=Fraction(1, 100)
        )
        split, palette = graph.add("split"), graph.add("palettegen", "stats_mode=single")
        use, self._sink = graph.add("paletteuse", "new=1:dither=sierra2_4a"), graph.add("buffersink")
        self._source.link_to(split)
        split.link_to(palette, 0, 0)
        palette.link_to(use, 0, 1)
        split.link_to(use, 1, 0)
        use.link_to(self._sink)
        graph.configure()
        self._graph = graph
        self._count = 0

    def apply(self, rgb: NDArray[np.uint8]) -> Any:
        """Return an image (H, W, 3) as a frame with a palette."""
        frame = av.VideoFrame.from_ndarray(rgb, format="rgb24")
        frame.pts, frame.time_base = self._count, Fraction(1, 100)
        self._count += 1
        self._source.push(frame)
        return self._sink.pull()


def _encode(container: Any, stream: Any, frame: Any) -> None:
    for packet in stream.encode(frame):
        container.mux(packet)
