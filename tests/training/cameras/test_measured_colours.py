"""The file of measured colour differences, and the corrections that start from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from fourd.base.errors import UserError
from fourd.reconstruction.training.cameras.measured_colours import (
    MeasuredColours,
    corrects_colours,
    read_measured_colours,
    write_measured_colours,
)
from fourd.reconstruction.training.cameras.refinement import Refinement
from fourd.reconstruction.training.config import RefineConfig
from tests.captures import ring_cameras

DARK = np.column_stack([0.8 * np.eye(3), np.full(3, 0.01)])


def test_the_file_gives_back_the_maps(tmp_path: Path) -> None:
    """Catches a format that loses the offset or the decision."""
    assert read_measured_colours(tmp_path) is None
    write_measured_colours(tmp_path, MeasuredColours({"01": DARK}, differ=True))
    found = read_measured_colours(tmp_path)
    assert found is not None
    assert found.differ
    expected = np.stack([DARK, np.eye(3, 4)])
    torch.testing.assert_close(found.stacked(["01", "02"]), torch.from_numpy(expected).float())


@pytest.mark.parametrize("text", ["[]", '{"differ": true}', '{"differ": true, "cameras": {"01": {"matrix": [[0]]}}}'])
def test_damaged_files_are_refused(tmp_path: Path, text: str) -> None:
    """Catches a traceback, and maps that are used although they are damaged."""
    (tmp_path / "colours").mkdir()
    (tmp_path / "colours" / "measured.json").write_text(text)
    with pytest.raises(UserError, match=r"measured.json: expected a matrix \(3, 3\) and an offset \(3\) per camera"):
        read_measured_colours(tmp_path)


def test_the_user_decides_before_the_measurement() -> None:
    """Catches a flag that the measurement overrules."""
    differ, equal = MeasuredColours({}, differ=True), MeasuredColours({}, differ=False)
    assert corrects_colours(None, differ)
    assert not corrects_colours(None, equal)
    assert not corrects_colours(None, None)
    assert corrects_colours(True, equal)
    assert not corrects_colours(False, differ)


def test_corrections_start_from_the_measured_maps() -> None:
    """Catches a held-out camera without its map, and a map that the learnt corrections replace."""
    maps = torch.eye(3, 4).repeat(4, 1, 1)
    maps[1], maps[2] = torch.from_numpy(DARK).float(), 2 * torch.eye(3, 4)
    refinement = Refinement(RefineConfig(colours=True), ring_cameras(4, 24), [0, 1, 3], np.zeros(3), maps)
    found = refinement.rig().colours
    assert found is not None
    torch.testing.assert_close(found, maps)
    rgb = torch.full((2, 2, 3), 0.5)
    torch.testing.assert_close(refinement.recolour(rgb, torch.ones(2, 2), 1), torch.full((2, 2, 3), 0.41))
