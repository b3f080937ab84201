"""Measure the coefficients of the cost model (tools/measurements/cluster/costs.json) on this machine.

    python tools/measurements/cluster/measure_costs.py CAPTURE -o tools/measurements/cluster/costs.json

CAPTURE must have image files and masks. Each stage runs several times on one core, with different numbers of frames,
cameras, pixels and points. The coefficients are fitted by non-negative least squares on the relative errors. The fit
uses CPU seconds, because other running programs affect them less than wall-clock time. The program prints the largest
relative error of each fit.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", FOURD_THREADS="1")

import cv2
import numpy as np
from scipy.optimize import nnls

from fourd.base.cameras import look_at
from fourd.base.files import write_text_atomically
from fourd.pipeline.stage import Context
from fourd.pipeline.stages.bake import BakeFiles, BakeSettings, bake_stage
from fourd.pipeline.stages.points.carve import CarveStageSettings, carve_run_stage
from fourd.pipeline.stages.train import TrainFiles, train_stage
from fourd.reconstruction.training.cameras.selection import DataSelection
from fourd.reconstruction.training.config import TrainConfig
from fourd.recording.capture import open_capture, write_calibration
from tools.measurements.cluster.cost_model import Costs
from tools.measurements.long_set import write_video

VIDEO_SIZE = (3840, 2160)
VIDEO_FRAMES = 60
STEPS = (20, 140)
"""Training stops at the first of these steps, is resumed, and ends at the second. The time of one step is computed from
the CPU seconds of the two parts."""
START = "import fourd.pipeline.graphs.run"
"""The imports that a stage's process runs before the stage starts its work."""


@dataclass(frozen=True)
class Case:
    """A run's number of frames, number of cameras, image scale and number of points."""

    frames: int
    cameras: int
    scale: float
    points: int


CASES = (
    Case(4, 20, 0.25, 3000),
    Case(4, 20, 0.25, 12000),
    Case(4, 20, 0.5, 12000),
    Case(4, 10, 0.5, 12000),
    Case(4, 20, 1.0, 24000),
)


@dataclass(frozen=True)
class Measured:
    """Costs of one case: the CPU seconds of its stages, and the sizes in bytes of the files that they write."""

    case: Case
    image_mp: float
    carve_s: float
    step_s: float
    train_start_s: float
    bake_s: float
    hull_bytes: int
    checkpoint_bytes: int
    scene_bytes: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, help="a capture with image files and masks")
    parser.add_argument("-o", "--out", type=Path, required=True, help="JSON file to write")
    arguments = parser.parse_args()
    capture = arguments.capture.resolve()
    with tempfile.TemporaryDirectory() as folder:
        # The first training run in a process also compiles kernels and fills caches, so its costs are not used.
        measure(capture, Path(folder) / "warm up", CASES[0])
        measured = [measure(capture, Path(folder) / str(index), case) for index, case in enumerate(CASES)]
        costs = fit(measured, cpu_seconds(lambda: subprocess.run([sys.executable, "-c", START], check=True)))
        costs["decode_s_per_mp"], costs["seek_s_per_mp"] = measure_decoding(capture, Path(folder) / "video")
    costs["matte_bytes_per_mp"] = matte_bytes_per_mp(capture)
    write_text_atomically(arguments.out, json.dumps(asdict(Costs(**costs)), indent=1) + "\n")
    print(arguments.out.read_text())


def measure_decoding(capture: Path, copy: Path) -> tuple[float, float]:
    """Return the CPU seconds per megapixel to decode video frames in order, and in random order. The video shows
    resized images of the capture."""
    cv2.setNumThreads(1)
    paths = sorted((capture / "images").glob("*/*"))[:8]
    pictures = [cv2.cvtColor(cv2.resize(cv2.imread(str(path)), VIDEO_SIZE), cv2.COLOR_BGR2RGB) for path in paths]
    write_video(copy / "videos" / "00.mp4", pictures, [frame % 8 for frame in range(VIDEO_FRAMES)], 30)
    width, height = VIDEO_SIZE
    intrinsics = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])
    up = np.array([0.0, 0.0, 1.0])
    write_calibration(copy, ["00"], [look_at(np.array([2.0, 0, 0]), np.zeros(3), up, intrinsics, width, height)])
    with open_capture(copy, mattes=False, cache_mb=1) as opened:
        opened.image(0, 0)
        orders = [range(1, VIDEO_FRAMES), np.random.default_rng(0).permutation(VIDEO_FRAMES)[:12].tolist()]
        seconds = [cpu_seconds(lambda order=order: [opened.image(0, frame) for frame in order]) for order in orders]
    in_order, in_random_order = (
        spent / (len(order) * width * height / 1e6) for spent, order in zip(seconds, orders, strict=True)
    )
    return in_order, in_random_order


def matte_bytes_per_mp(capture: Path) -> float:
    """Return the size of the mask files in bytes per megapixel."""
    with open_capture(capture) as opened:
        megapixels = opened.frame_count * sum(camera.width * camera.height for camera in opened.cameras) / 1e6
    return bytes_in(capture / "masks") / megapixels


def measure(capture: Path, run: Path, case: Case) -> Measured:
    """Carve the visual hulls of a run, train it in two parts and export its scene. Return the costs of these stages."""
    with open_capture(capture) as opened:
        views, whole = tuple(opened.names[: case.cameras]), opened.cameras[0]
    config = TrainConfig(
        views=views, frames=f"0:{case.frames}", image_scale=case.scale, points=case.points, max_steps=STEPS[0]
    )
    carving = CarveStageSettings(DataSelection.of(config), case.points)
    carve_s = cpu_seconds(lambda: carve_run_stage(capture, run, carving, False).run(Context()))
    files, seconds = TrainFiles(capture, run), []
    for steps in STEPS:
        longer = replace(config, max_steps=steps)
        seconds.append(cpu_seconds(lambda longer=longer: train_stage(files, longer).run(Context())))
    # The first part of the training runs STEPS[0] steps, and the second part runs STEPS[1] - STEPS[0] steps. The time
    # to start training is the same in both parts, so it cancels out in the difference.
    step_s = max(seconds[1] - seconds[0], 0) / (STEPS[1] - 2 * STEPS[0])
    scene = run / "scene.4dv"
    bake_s = cpu_seconds(lambda: bake_stage(BakeFiles(run, scene), BakeSettings()).run(Context()))
    measured = Measured(
        case,
        whole.width * whole.height * case.scale**2 / 1e6,
        carve_s,
        step_s,
        max(seconds[0] - STEPS[0] * step_s, 0),
        bake_s,
        bytes_in(run / "hull"),
        bytes_in(run / "checkpoints"),
        scene.stat().st_size,
    )
    print(measured, flush=True)
    return measured


def fit(measured: Sequence[Measured], start_s: float) -> dict[str, float]:
    """Fit the coefficients of :class:`~tools.measurements.cluster.cost_model.Costs`."""
    cases = [item.case for item in measured]
    frame_points = [case.frames * case.points for case in cases]
    carve = _fit(
        "carving",
        [(case.frames * case.cameras, points) for case, points in zip(cases, frame_points, strict=True)],
        [item.carve_s for item in measured],
    )
    step = _fit(
        "training step",
        [(1.0, item.case.points, item.image_mp) for item in measured],
        [item.step_s for item in measured],
    )
    bake = _fit(
        "baking",
        [(case.frames, points * case.cameras) for case, points in zip(cases, frame_points, strict=True)],
        [item.bake_s for item in measured],
    )
    checkpoint = _fit(
        "checkpoint", [(1.0, points) for points in frame_points], [item.checkpoint_bytes for item in measured]
    )
    scene = _fit(
        "scene",
        [(points, points * case.cameras) for case, points in zip(cases, frame_points, strict=True)],
        [item.scene_bytes for item in measured],
    )
    hull = _fit("points", [(points,) for points in frame_points], [item.hull_bytes for item in measured])
    return {
        "stage_start_s": start_s,
        "carve_s_per_image": carve[0],
        "carve_s_per_point": carve[1],
        "train_start_s": float(np.median([item.train_start_s for item in measured])),
        "step_s": step[0],
        "step_s_per_point": step[1],
        "step_s_per_mp": step[2],
        "bake_s_per_frame": bake[0],
        "bake_s_per_colour": bake[1],
        "hull_bytes_per_point": hull[0],
        "checkpoint_bytes": checkpoint[0],
        "checkpoint_bytes_per_point": checkpoint[1],
        "scene_bytes_per_point": scene[0],
        "scene_bytes_per_colour": scene[1],
    }


def _fit(what: str, features: Sequence[Sequence[float]], values: Sequence[float]) -> list[float]:
    """Fit a linear combination of the features to the values, with non-negative coefficients. Return the coefficients
    with the smallest sum of squared relative errors."""
    matrix, target = np.array(features, float), np.array(values, float)
    scaled = matrix / target[:, None]  # After this division, the residuals are relative errors.
    # Each column is divided by its largest absolute value, because the features differ by orders of magnitude.
    sizes = np.abs(scaled).max(axis=0)
    found = nnls(scaled / sizes, np.ones(len(target)))[0] / sizes
    errors = matrix @ found / target - 1
    print(f"{what}: largest relative error {np.abs(errors).max():.0%}")
    return [float(value) for value in found]


def cpu_seconds(work: Callable[[], object]) -> float:
    """Return the CPU seconds that this process and its child processes spend in ``work``."""

    def spent() -> float:
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.process_time() + children.ru_utime + children.ru_stime

    start = spent()
    work()
    return spent() - start


def bytes_in(folder: Path) -> int:
    """Return the total size in bytes of all files below a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


if __name__ == "__main__":
    main()
