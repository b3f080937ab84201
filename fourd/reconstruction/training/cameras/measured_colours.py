"""The colour differences between cameras that were measured before training: ``RUN/colours/measured.json``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.limits import read_json
from fourd.reconstruction.training.run_layout import COLOURS, MEASURED


@dataclass(frozen=True, eq=False)
class MeasuredColours:
    """Colour differences between the cameras of a run, held-out cameras included.

    Attributes:
        maps: camera name -> (3, 4) affine map ``[M, offset]`` from the scene's colours to the camera's colours.
        differ: whether matching points show that the cameras differ.
    """

    maps: Mapping[str, NDArray[np.float64]]
    differ: bool

    def stacked(self, names: Sequence[str]) -> Tensor:
        """Return the maps (V, 3, 4) of the cameras ``names`` as float32. Cameras without a map get the identity."""
        maps = [self.maps.get(name, np.eye(3, 4)) for name in names]
        return torch.from_numpy(np.stack(maps)).float()


def corrects_colours(wanted: bool | None, measured: MeasuredColours | None) -> bool:
    """Return whether a run corrects the colours of its cameras. ``wanted`` is the config's ``refine.colours``; if it is
    None, the measured differences decide."""
    return wanted if wanted is not None else measured is not None and measured.differ


def write_measured_colours(run: Path, measured: MeasuredColours) -> None:
    """Store the measured colour differences in the folder ``run``."""
    cameras = {
        name: {"matrix": each[:, :3].tolist(), "offset": each[:, 3].tolist()} for name, each in measured.maps.items()
    }
    state = {"differ": measured.differ, "cameras": cameras}
    write_text_atomically(run / COLOURS / MEASURED, json.dumps(state, indent=1) + "\n")


def read_measured_colours(run: Path) -> MeasuredColours | None:
    """Read the measured colour differences of a run. Returns None if they were not measured. Raises UserError if the
    file is damaged."""
    path = run / COLOURS / MEASURED
    if not path.exists():
        return None
    state = read_json(path)
    try:
        maps = {str(name): _colour_map(each) for name, each in state["cameras"].items()}
        return MeasuredColours(maps, bool(state["differ"]))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UserError(
            f"{path}: expected a matrix (3, 3) and an offset (3) per camera, got a damaged file; delete the folder "
            f"{path.parent}"
        ) from error


def _colour_map(state: Any) -> NDArray[np.float64]:
    matrix, offset = np.array(state["matrix"], np.float64), np.array(state["offset"], np.float64)
    if matrix.shape != (3, 3) or offset.shape != (3,) or not (np.isfinite(matrix).all() and np.isfinite(offset).all()):
        raise ValueError("expected finite numbers")
    if abs(np.linalg.det(matrix)) < 1e-3:
        raise ValueError("expected an invertible matrix")
    return np.column_stack([matrix, offset])
