"""Names of files and folders of a run.

``config.yaml`` is written once, when training starts. ``hull/``, ``background/`` and ``calibration/`` contain the
results of the stages before training. ``checkpoints/`` contains STEP.safetensors and STEP.points/.
"""

from __future__ import annotations

CONFIG_NAME = "config.yaml"
HULL = "hull"
"""Folder with bounds.json and, for each frame, the initial points in FRAME.ply."""
BACKGROUND = "background"
"""Folder of the initial points of a full scene's background, and of plates that were computed by the run."""
POINTS = "points.ply"
PLATES = "plates"
CALIBRATION = "calibration"
START = "start"
"""Subfolder of ``calibration/`` with the cameras with which training starts."""
CHECKPOINTS = "checkpoints"
SCRATCH = "scratch"
PREPARATION = (HULL, BACKGROUND, CALIBRATION)
"""Folders that are written before training. They may exist before ``config.yaml``, which marks the folder as a run."""
