"""The test split of a capture: split.json, and the held-out cameras that training takes from it."""

from __future__ import annotations

from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.reconstruction.training.cameras.selection import with_test_split
from fourd.reconstruction.training.config import TrainConfig
from fourd.recording.capture.layout import select_views
from fourd.recording.capture.split import read_test_views, write_test_views
from tests.captures import write_ball_capture


def test_split_is_the_default_of_test_views(tmp_path: Path) -> None:
    """Catches a test split that is trained on, is used without a word, or cannot be switched off."""
    capture, lines = write_ball_capture(tmp_path, cameras=4, frames=1, size=16), list[str]()
    assert with_test_split(TrainConfig(), capture, lines.append).test_views == ()
    assert lines == []
    write_test_views(capture, ["01", "03"])
    assert with_test_split(TrainConfig(), capture, lines.append).test_views == ("01", "03")
    assert len(lines) == 1
    assert "held out: 01, 03" in lines[0]
    assert with_test_split(TrainConfig(test_views=()), capture, lines.append).test_views == ()
    assert with_test_split(TrainConfig(test_views=("00",)), capture, lines.append).test_views == ("00",)
    assert with_test_split(TrainConfig(views=("00", "1", "02")), capture, lines.append).test_views == ("01",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"version": 2, "test_views": []}', "expected version 1, got 2; update fourd"),
        ('{"version": 1, "test_views": "01"}', "test_views, which is a list of different camera names"),
        ('{"version": 1, "test_views": ["01", "01"]}', "list of different camera names"),
        ('{"version": 1, "test_views": ["01"], "train_views": []}', "expected the keys version and test_views"),
        ('{"version": 1, "test_views": ["09"]}', "expected cameras among 00, 01, 02, got '09'; correct"),
        ("[", "expected the keys version and test_views"),
    ],
)
def test_damaged_splits_are_reported(tmp_path: Path, text: str, message: str) -> None:
    """Catches a damaged split that is ignored, so that all cameras are trained on."""
    write_ball_capture(tmp_path, cameras=3, frames=1, size=16)
    (tmp_path / "split.json").write_text(text)
    with pytest.raises(UserError, match=f"split.json: .*{message}"):
        with_test_split(TrainConfig(), tmp_path, str)


def test_missing_split_is_none(tmp_path: Path) -> None:
    assert read_test_views(tmp_path) is None


def test_numbers_select_padded_names() -> None:
    """Catches --test-views 0 that is refused for the camera 00, or selects an ambiguous camera."""
    assert select_views(["0", "010"], ["00", "01", "10"]) == ["00", "10"]
    assert select_views(["1"], ["1", "01"]) == ["1"]
    with pytest.raises(UserError, match="got '001'"):
        select_views(["001"], ["1", "01"])
