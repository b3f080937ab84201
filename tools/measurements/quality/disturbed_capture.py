"""Perturb the calibration of a capture by a known amount, and compare calibrations.

    python tools/measurements/quality/disturbed_capture.py make CAPTURE OUT [--degrees 0.5] [--metres 0.01] [--seed 0]

    python tools/measurements/quality/disturbed_capture.py compare CAPTURE OTHER... [--without 03,09,14]

``make`` writes a perturbed intri.yml and extri.yml to OUT, and links to the other files and folders of CAPTURE.
``compare`` aligns the cameras of each OTHER to those of CAPTURE by a similarity transform, and prints the remaining
pose errors. OTHER is a capture, or the folder RUN/calibration of a run. Use ``--without`` to exclude cameras from the
comparison, for example held-out cameras, which training does not refine.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from fourd.base.cameras import Camera
from fourd.recording.calibration.perturbation import perturb_cameras, pose_errors
from fourd.recording.capture.calibration import read_calibration, write_calibration
from fourd.recording.capture.layout import EXTRINSICS_NAME, INTRINSICS_NAME


def make(capture: Path, out: Path, degrees: float = 0.5, metres: float = 0.01, seed: int = 0) -> None:
    """Make the capture ``out`` from ``capture`` with perturbed cameras."""
    out.mkdir(parents=True)
    for entry in sorted(capture.iterdir()):
        if entry.name not in (INTRINSICS_NAME, EXTRINSICS_NAME, ".fourd"):
            (out / entry.name).symlink_to(entry.resolve())
    moved = perturb_cameras(cameras_of(capture), degrees, metres, np.random.default_rng(seed))
    write_calibration(out, list(moved), list(moved.values()))


def compare(capture: Path, others: list[Path], without: list[str]) -> None:
    """Print each folder's mean and maximum camera pose error relative to ``capture``."""
    truth = cameras_of(capture)
    for other in others:
        cameras = {name: camera for name, camera in cameras_of(other).items() if name not in without}
        errors = pose_errors(truth, cameras).values()
        rotations, distances = [error.degrees for error in errors], [error.distance for error in errors]
        print(
            f"{other}: mean rotation error {np.mean(rotations):.4f} degrees (maximum {max(rotations):.4f}), "
            f"mean distance of centres {np.mean(distances):.5f} (maximum {max(distances):.5f})"
        )


def cameras_of(folder: Path) -> dict[str, Camera]:
    """Return a folder's cameras by name. A missing image size is set to 1, because pose errors do not depend on it."""
    return {name: each.camera(each.width or 1, each.height or 1) for name, each in read_calibration(folder).items()}


def main() -> None:
    """Parse the command line, then run ``make`` or ``compare``."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    make_parser = commands.add_parser("make")
    make_parser.add_argument("capture", type=Path)
    make_parser.add_argument("out", type=Path)
    make_parser.add_argument("--degrees", type=float, default=0.5)
    make_parser.add_argument("--metres", type=float, default=0.01)
    make_parser.add_argument("--seed", type=int, default=0)
    compare_parser = commands.add_parser("compare")
    compare_parser.add_argument("capture", type=Path)
    compare_parser.add_argument("others", type=Path, nargs="+")
    compare_parser.add_argument("--without", default="")
    arguments = parser.parse_args()
    if arguments.command == "make":
        make(arguments.capture, arguments.out, arguments.degrees, arguments.metres, arguments.seed)
    else:
        compare(arguments.capture, arguments.others, arguments.without.split(","))


if __name__ == "__main__":
    main()
