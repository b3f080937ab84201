"""Make long videos for long-running tests, by playing a short capture repeatedly forwards and backwards.

    python tools/measurements/long_set.py CAPTURE OUT --seconds 180 --cameras 8 --size 160

The program writes one video OUT/videos/CAM.mp4 per camera, and the calibration. ``fourd import`` reads the folder OUT.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from fourd.base.files import atomic_path
from fourd.recording.capture import open_capture, write_calibration
from fourd.recording.capture.layout import VIDEOS, sample_indices

Picture = NDArray[np.uint8]

ENCODING = {"crf": "16", "g": "60"}


def main() -> None:
    """Write the videos and the calibration."""
    arguments = _parse_arguments()
    names = open_capture(arguments.capture, mattes=False).names
    chosen = [names[place] for place in sample_indices(len(names), arguments.cameras)]
    whole = open_capture(arguments.capture, views=chosen, mattes=False)
    longest = max(max(camera.width, camera.height) for camera in whole.cameras)
    capture = open_capture(arguments.capture, views=chosen, mattes=False, scale=arguments.size / longest)
    for camera in capture.cameras:
        if camera.width % 2 or camera.height % 2:
            sys.exit(
                f"--size: expected even image sides, as H.264 needs, got {camera.width} x {camera.height}; change it"
            )
    shown = back_and_forth(capture.frame_count, round(arguments.seconds * arguments.fps))
    for index, name in enumerate(capture.names):
        pictures = [capture.image(index, frame) for frame in range(capture.frame_count)]
        write_video(arguments.out / VIDEOS / f"{name}.mp4", pictures, shown, arguments.fps)
        print(f"{name}: {len(shown)} frames")
    write_calibration(arguments.out, capture.names, capture.cameras)


def back_and_forth(count: int, length: int) -> list[int]:
    """Return a list of ``length`` indices, which run through ``count`` frames alternately forwards and backwards."""
    period = max(1, 2 * (count - 1))
    return [min(place % period, period - place % period) for place in range(length)]


def write_video(path: Path, pictures: Sequence[Picture], shown: Sequence[int], fps: int) -> None:
    """Write an H.264 video atomically.

    Args:
        path: the file.
        pictures: images (H, W, 3) with even width and height.
        shown: index into ``pictures`` for each video frame.
        fps: frames per second.
    """
    frames = [av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(format="yuv420p") for picture in pictures]
    with atomic_path(path) as temporary, av.open(str(temporary), "w") as container:
        stream = container.add_stream("libx264", rate=fps, options=ENCODING)
        stream.width, stream.height, stream.pix_fmt = frames[0].width, frames[0].height, "yuv420p"
        for place, position in enumerate(shown):
            frame = frames[position]
            frame.pts, frame.time_base = place, Fraction(1, fps)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def _parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, help="the short capture")
    parser.add_argument("out", type=Path, help="folder to write to")
    parser.add_argument("--seconds", type=float, default=180.0, help="length of each video (default 180)")
    parser.add_argument("--cameras", type=int, default=8, help="number of evenly spread cameras (default 8)")
    parser.add_argument("--size", type=int, default=160, help="longer side of the images in pixels (default 160)")
    parser.add_argument("--fps", type=int, default=30, help="frames per second (default 30)")
    return parser.parse_args()


if __name__ == "__main__":
    main()
