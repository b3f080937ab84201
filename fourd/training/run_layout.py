"""Names of files and folders of a run.

``config.yaml`` is written once, when training starts. ``hull/``, ``background/`` and ``calibration/`` hold the results
of the stages before it; ``checkpoints/`` holds STEP.safetensors and STEP.points/.
"""

from __future__ import annotations

CONFIG_NAME = "config.yaml"
HULL = "hull"
"""First points of each frame, FRAME.ply, and bounds.json."""
BACKGROUND = "background"
"""First points of a full scene's background, and the plates that the run made itself."""
POINTS = "points.ply"
PLATES = "plates"
CALIBRATION = "calibration"
START = "start"
"""Below ``calibration/``: the cameras that training starts with."""
CHECKPOINTS = "checkpoints"
SCRATCH = "scratch"
PREPARATION = (HULL, BACKGROUND, CALIBRATION)
"""Folders that exist before a folder is a run."""
