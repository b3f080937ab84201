"""Names of files and folders of a run.

``config.yaml`` is written once, when training starts. ``hull/``, ``background/`` and ``calibration/`` contain the
results of the stages before training. ``checkpoints/`` contains STEP.safetensors and STEP.points/. A run with segments
has ``segments/`` instead of ``checkpoints/``.
"""

from __future__ import annotations

from pathlib import Path

CONFIG_NAME = "config.yaml"
HULL = "hull"
"""Folder with the files bounds.json and quality.json and, for each frame, a file FRAME.ply with the frame's initial
points."""
HULL_QUALITY = "quality.json"
"""File in the folder ``hull/``: how much of the mattes the visual hull covers, measured in a few frames."""
BACKGROUND = "background"
"""Folder with the initial background points of a full scene and the clean plates that the run computed."""
POINTS = "points.ply"
PLATES = "plates"
NEAR = "near.json"
"""File in the folder of the background: the depth of the near plane that static surfaces allow."""
CALIBRATION = "calibration"
COLOURS = "colours"
"""Folder with the colour differences between the cameras that were measured before training."""
MEASURED = "measured.json"
START = "start"
"""Subfolder of ``calibration/`` that contains the cameras with which training starts."""
CHECKPOINTS = "checkpoints"
SCRATCH = "scratch"
VALIDATION = "validation"
SOURCE = "source"
"""Folder with the copy of a capture that was given as a URL."""
LIVE = "live"
"""Folder with the state of a training run and the last request to it; see :mod:`fourd.reconstruction.training.live`."""
SEGMENTS = "segments"
"""Folder with one run per segment, named 000, 001 and so on. Runs without segments do not have this folder."""
PREPARATION = (HULL, BACKGROUND, CALIBRATION, COLOURS, SOURCE)
"""Subfolders that are written before training. They can exist before ``config.yaml``, but only a folder with
``config.yaml`` is a run."""


def checkpoint_files(folder: Path) -> list[Path]:
    """List the checkpoint files in ``folder``, in the order of their steps. Temporary files, whose names start with a
    dot, are not included."""
    named = [path for path in folder.glob("*.safetensors") if path.stem.isdecimal()]
    return sorted(named, key=lambda path: int(path.stem))


def points_folder(checkpoint: Path) -> Path:
    """Return the path of the folder that contains the points of a checkpoint."""
    return checkpoint.with_suffix(".points")


def segment_folder(run: Path, index: int) -> Path:
    """Return the path of a segment's run folder."""
    return run / SEGMENTS / f"{index:03d}"


def segment_folders(run: Path) -> list[Path]:
    """List the existing run folders of segments, in the order of their frames."""
    named = [path for path in (run / SEGMENTS).glob("*") if path.name.isdecimal()]
    return sorted(named, key=lambda path: int(path.name))


def newest_checkpoint(run: Path) -> str:
    """Return the file name of a run's newest checkpoint, or an empty string if there is none."""
    return max((path.name for path in checkpoint_files(run / CHECKPOINTS)), default="")
