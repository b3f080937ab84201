"""Captures with a calibration that is off by a known amount, and how far calibrations are from the truth.

    python tools/disturbed_capture.py make CAPTURE OUT [--degrees 0.5] [--metres 0.01] [--seed 0]
    python tools/disturbed_capture.py compare CAPTURE OTHER... [--without 03,09,14]

``make`` links CAPTURE's folders into OUT and writes disturbed intri.yml and extri.yml there. ``compare`` prints the
pose errors of other folders' cameras (a capture, or RUN/calibration) after a similarity has aligned them; cameras that
a run held out stay as they were given there, and are best left out.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from fourd.calibration.perturbation import perturb_cameras, pose_errors
from fourd.cameras import Camera
from fourd.capture.calibration import EXTRINSICS_NAME, INTRINSICS_NAME, read_calibration, write_calibration


def make(capture: Path, out: Path, degrees: float, metres: float, seed: int) -> None:
    """A copy of a capture whose cameras are disturbed."""
    out.mkdir(parents=True)
    for entry in sorted(capture.iterdir()):
        if entry.name not in (INTRINSICS_NAME, EXTRINSICS_NAME, ".fourd"):
            (out / entry.name).symlink_to(entry.resolve())
    moved = perturb_cameras(cameras_of(capture), degrees, metres, np.random.default_rng(seed))
    write_calibration(out, list(moved), list(moved.values()))


def compare(capture: Path, others: list[Path], without: list[str]) -> None:
    """Print each folder's mean and largest errors."""
    truth = cameras_of(capture)
    for other in others:
        cameras = {name: camera for name, camera in cameras_of(other).items() if name not in without}
        errors = pose_errors(truth, cameras).values()
        turns, shifts = [error.degrees for error in errors], [error.distance for error in errors]
        print(
            f"{other}: rotation {np.mean(turns):.4f} degrees (at most {max(turns):.4f}), "
            f"centre {np.mean(shifts):.5f} (at most {max(shifts):.5f})"
        )


def cameras_of(folder: Path) -> dict[str, Camera]:
    """Cameras by name; sizes that the calibration does not give are of no matter here."""
    return {name: each.camera(each.width or 1, each.height or 1) for name, each in read_calibration(folder).items()}


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("make")
    one.add_argument("capture", type=Path)
    one.add_argument("out", type=Path)
    one.add_argument("--degrees", type=float, default=0.5)
    one.add_argument("--metres", type=float, default=0.01)
    one.add_argument("--seed", type=int, default=0)
    two = commands.add_parser("compare")
    two.add_argument("capture", type=Path)
    two.add_argument("others", type=Path, nargs="+")
    two.add_argument("--without", default="")
    arguments = parser.parse_args()
    if arguments.command == "make":
        make(arguments.capture, arguments.out, arguments.degrees, arguments.metres, arguments.seed)
    else:
        compare(arguments.capture, arguments.others, arguments.without.split(","))


if __name__ == "__main__":
    main()
