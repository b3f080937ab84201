"""A second scene that cannot be shown."""

from __future__ import annotations

import time
from pathlib import Path

import moderngl
import pytest

from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.viewer.comparison.comparison import Comparison
from fourd.viewer.display import DisplaySettings
from fourd.viewer.session import Session
from tests.viewer.gl import contexts

context = pytest.fixture(contexts)


@pytest.mark.parametrize("is_given", [True, False])
def test_a_damaged_scene_ends_the_comparison(is_given: bool, context: moderngl.Context, tmp_path: Path) -> None:
    """Catches half a window that stays empty, an error that nobody sees, and a window that goes on although a scene of
    the command line cannot be opened, or ends because of a scene that the user has typed."""
    (tmp_path / "broken.4dv").write_bytes(b"PK\3\4 and nothing else")
    comparison = Comparison(context, None, tmp_path / "broken.4dv" if is_given else None)
    comparison.start()
    if not is_given:
        comparison.set_other(tmp_path / "broken.4dv")
    error, end = "", time.monotonic() + 60
    while not error and time.monotonic() < end:
        assert comparison.other is not None
        comparison.other.follow(Session(DisplaySettings(layers=1)), (64, 64), (0.0, 0.0), "cpu")
        error = comparison.take_error()
    assert "broken.4dv: expected a complete .4dv scene" in error
    assert not comparison.is_on
    assert comparison.other is None
    assert isinstance(comparison.given_error, UserError) is is_given


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("scene.4dv", "--beside", "none.4dv"), "--beside none.4dv: expected a file or a folder, got nothing there"),
        (("--beside", "scene.4dv"), "--beside: expected a scene to compare with, got none"),
        (("scene.4dv", "--beside", "scene.4dv", "--screenshot", "a.png"), "--beside: expected a window to compare in"),
        (("scene.4dv", "--capture", ".", "--headless", "a.mp4"), "--capture: expected a window to compare in"),
    ],
)
def test_comparisons_that_cannot_be_shown_are_refused(
    words: tuple[str, ...],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Catches a comparison that is ignored without a word."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.4dv").write_bytes(b"")
    assert main(["view", *words]) == 2
    assert message in capsys.readouterr().err
