"""Measure how often estimated time offsets are right, on videos with other starts that are cut from synchronous ones.

Each trial takes four cameras of a capture and 60 to 75% of its frames, which begin at a random frame in each camera; in
every third trial, they begin at the same frame. The offsets are estimated from the motion energies of the whole images,
and from the motion in common epipolar planes. Prints, for each class of confidence, the number of offsets and the
fractions that are right within 1 and within 3 frames.

Usage: .venv/bin/python tools/measurements/quality/sync_offsets.py CAPTURE [CAPTURE ...]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from fourd.base.cameras import Camera
from fourd.recording.capture.reader import open_capture
from fourd.recording.sync.epipolar import MotionRecord, estimate_epipolar_offsets
from fourd.recording.sync.motion import MIN_OVERLAP, UNRELIABLE_FRAMES, WIDTH_PX, Offsets, estimate_offsets

CAMERAS = 4
CLASSES = ((0.0, 0.1), (0.1, 0.3), (0.3, 0.5), (0.5, 1.01))
METHODS = ("energies", "epipolar planes")


@dataclass(frozen=True)
class Found:
    """An estimated offset: its method, confidence and error in frames, and whether the videos were synchronous."""

    method: str
    confidence: float
    error: float
    is_synchronous: bool


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--trials", type=int, default=60)
    arguments = parser.parse_args()
    for capture in arguments.captures:
        cameras, records = read_motion(capture)
        found = list(estimates(cameras, records, arguments.trials))
        for method in METHODS:
            print_table(capture.name, method, [each for each in found if each.method == method])


def read_motion(path: Path) -> tuple[list[Camera], list[MotionRecord]]:
    """Record the motion in all cameras of a capture."""
    with open_capture(path, mattes=False) as capture:
        widest = max(camera.width for camera in capture.cameras)
    with open_capture(path, mattes=False, scale=min(1.0, WIDTH_PX / widest)) as capture:
        records = [
            MotionRecord.of(
                np.asarray(cv2.cvtColor(capture.image(camera, frame), cv2.COLOR_RGB2GRAY), np.uint8)
                for frame in range(capture.frame_count)
            )
            for camera in range(len(capture.cameras))
        ]
        return list(capture.cameras), records


def estimates(cameras: list[Camera], records: list[MotionRecord], trials: int) -> Iterator[Found]:
    """Yield the offsets that both methods find in the cut videos, except for the first camera, whose offset is 0."""
    rng = np.random.default_rng(1)
    total = len(records[0].pixels)
    for trial in range(trials):
        chosen = sorted(rng.choice(len(cameras), min(CAMERAS, len(cameras)), replace=False))
        count = int(total * rng.uniform(0.6, 0.75))
        is_synchronous = trial % 3 == 2
        starts = (
            np.full(len(chosen), (total - count) // 2)
            if is_synchronous
            else rng.integers(0, total - count + 1, len(chosen))
        )
        cut = [_cut(records[camera], int(start), count) for camera, start in zip(chosen, starts, strict=True)]
        whole = estimate_offsets([record.energies for record in cut], min(count // 3, count - MIN_OVERLAP))
        planes = estimate_epipolar_offsets(cut, [cameras[camera] for camera in chosen], 300)
        none = Offsets((0,) * len(chosen), (0.0,) * len(chosen), (0.0,) * len(chosen))
        for method, offsets in zip(METHODS, (whole, planes or none), strict=True):
            for index in range(1, len(chosen)):
                error = abs(offsets.subframes[index] - float(starts[0] - starts[index]))
                yield Found(method, offsets.confidence[index], error, is_synchronous)


def _cut(record: MotionRecord, start: int, count: int) -> MotionRecord:
    frames = slice(start, start + count)
    return replace(
        record, energies=record.energies[frames], pixels=record.pixels[frames], amounts=record.amounts[frames]
    )


def print_table(name: str, method: str, found: list[Found]) -> None:
    """Print the numbers of offsets and the fractions of right ones, for each class of confidence."""
    parts = []
    for low, high in CLASSES:
        errors = np.array([each.error for each in found if low <= each.confidence < high])
        right = "" if len(errors) == 0 else f" ({np.mean(errors <= 1):.0%}, {np.mean(errors <= 3):.0%})"
        parts.append(f"{low:.1f} to {min(high, 1):.1f}: {len(errors)}{right}")
    wrong = sum(
        each.is_synchronous and each.error > UNRELIABLE_FRAMES + 0.5 and each.confidence >= CLASSES[-1][0]
        for each in found
    )
    print(f"{name}: {method}: {'; '.join(parts)}; applied to synchronous videos: {wrong}")


if __name__ == "__main__":
    main()
