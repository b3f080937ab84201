"""Measure how much a scene changes from frame to frame, inside segments and between them.

    python tools/measurements/quality/segment_jumps.py RUN SCENE.4dv

RUN was trained in segments: ranges of frames that are trained separately and overlap by some frames. A frame step is
the mean absolute difference between the images of two successive frames, averaged over the run's held-out cameras. It
counts as a step between segments if the two frames belong to different segments, or if at least one of them is in the
overlap of two segments. The subject does not move by the same amount in every frame, so the steps of the captured
images are measured too, for comparison.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.reconstruction.training.run import Run, open_run
from fourd.reconstruction.training.segments.plan import SegmentPlan
from fourd.scene import open_scene


def main(run_path: Path, scene_path: Path) -> None:
    with open_run(run_path) as run, open_scene(scene_path) as scene:
        cameras = [run.capture.cameras[index] for index in run.test]

        def rendered(frame: int) -> list[NDArray[np.float32]]:
            return [scene.render(camera, frame).rgb.clip(0, 1) for camera in cameras]

        def captured(frame: int) -> list[NDArray[np.float32]]:
            return [_on_black(run, index, frame) for index in run.test]

        count = run.capture.frame_count
        steps = {"scene": _steps(rendered, count), "capture": _steps(captured, count)}
        between = _steps_between_segments(run)
    for name, values in steps.items():
        print(
            f"{name}: mean step {values.mean():.5f}; inside segments {values[~between].mean():.5f}, between segments "
            f"{values[between].mean():.5f} on average and {values[between].max():.5f} at most, "
            f"{values[between].max() / values.mean():.2f} times the mean step"
        )
    relative = steps["scene"] / steps["capture"]
    print(
        f"step of the scene over step of the capture: inside segments {relative[~between].mean():.3f}, between "
        f"segments {relative[between].mean():.3f} on average and {relative[between].max():.3f} at most"
    )


def _steps(frame_images: Callable[[int], list[NDArray[np.float32]]], count: int) -> NDArray[np.float64]:
    """Return the ``count`` - 1 frame steps of ``count`` frames. A frame step is the mean absolute difference between
    the images of two successive frames. ``frame_images`` returns the images of a frame."""
    steps, before = [], frame_images(0)
    for frame in range(1, count):
        after = frame_images(frame)
        steps.append(np.mean([np.abs(a - b).mean() for a, b in zip(after, before, strict=True)]))
        before = after
    return np.array(steps)


def _on_black(run: Run, index: int, frame: int) -> NDArray[np.float32]:
    """Return the captured image, (H, W, 3) in [0, 1], multiplied by its matte."""
    matte = run.capture.mask(index, frame)[..., None] / np.float32(255)
    return np.asarray(run.capture.image(index, frame) * matte / 255, np.float32)


def _steps_between_segments(run: Run) -> NDArray[np.bool_]:
    """Return a mask (F - 1,) with one entry for each two successive frames of a run of F frames. An entry is true if
    the two frames belong to different segments, or if at least one of them is in the overlap of two segments."""
    count = run.capture.frame_count
    plan = SegmentPlan.divide(count, run.config.train.segments)
    owners = [plan.shares(frame) for frame in range(count)]
    return np.array([owners[frame] != owners[frame + 1] for frame in range(count - 1)])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
