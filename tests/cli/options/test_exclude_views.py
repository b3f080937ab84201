"""--exclude-views, which leaves out cameras instead of listing all others."""

from __future__ import annotations

from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.cli.options import SelectionOptions, chosen_views
from fourd.cli.training_options import TrainingOptions
from fourd.reconstruction.training.config import TrainConfig
from fourd.recording.capture import open_capture
from fourd.recording.capture.layout import select_views

NAMES = ["00", "01", "02", "left"]


def test_excluded_cameras_are_left_out() -> None:
    """Catches an exclusion that selects the excluded cameras, and a number that excludes no camera."""
    assert select_views(SelectionOptions(exclude_views="1,left").names, NAMES) == ["00", "02"]
    config = TrainingOptions(exclude_views="left", max_steps=1).overlay(TrainConfig())
    assert select_views(config.views, NAMES) == ["00", "01", "02"]
    assert SelectionOptions(views="01").names == ("01",)


def test_a_capture_opens_without_excluded_cameras(ball_capture: Path) -> None:
    """Catches an exclusion that only some readers understand."""
    with open_capture(ball_capture, views=chosen_views(None, "01")) as capture:
        assert "01" not in capture.names
        assert len(capture.names) > 1


@pytest.mark.parametrize(
    ("views", "excluded", "message"),
    [
        ("01", "02", "--views, --exclude-views: expected one of them, got both; remove one"),
        (None, " ", "--exclude-views: expected camera names, got none"),
        (None, "00,01,02,left", "--exclude-views: expected at least one camera that is left, got all cameras"),
        (None, "rigth", "--exclude-views: expected camera names among 00, 01, 02, left, got 'rigth'; did you mean"),
    ],
)
def test_impossible_exclusions_are_refused(views: str | None, excluded: str, message: str) -> None:
    """Catches an exclusion that is ignored because of a mistyped name."""
    with pytest.raises(UserError) as caught:
        select_views(chosen_views(views, excluded), NAMES)
    assert message in str(caught.value)


def test_carve_refuses_an_unknown_camera(
    ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a command that does not pass the exclusion on."""
    assert main(["carve", str(ball_capture), "-o", str(tmp_path / "out"), "--exclude-views", "nobody"]) == 2
    assert "--exclude-views: expected camera names among" in capsys.readouterr().err
