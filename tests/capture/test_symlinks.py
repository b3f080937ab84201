"""Symbolic links at or below CAPTURE/.fourd are refused before any file is deleted in this folder."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.base.progress import untracked
from fourd.reconstruction.carving import carve_capture
from fourd.recording.capture import open_capture
from fourd.recording.capture.layout import refuse_symlinks
from fourd.recording.importing.detection import pick_format
from fourd.recording.importing.importer import ImportOptions, import_source
from fourd.recording.matting.plates import make_plates
from fourd.recording.matting.selection import Selection
from fourd.recording.matting.sequence import MatteSettings, make_mattes
from tests.importing.formats.sources import write_pictures


def matte(capture: Path) -> None:
    make_mattes(Selection(capture), MatteSettings(), 1, untracked)


def plate(capture: Path) -> None:
    make_plates(Selection(capture), "key", 1, untracked)


def carve(capture: Path) -> None:
    carve_capture(open_capture(capture), capture / ".fourd" / "hulls", points=100)


def bring_in(capture: Path) -> None:
    source = capture.parent / "source"
    write_pictures(source / "00", ["0.jpg"])
    found = pick_format("videos", source)
    import_source(
        found, source, capture, ImportOptions(), log=lambda line: None, warn=lambda line: None, track=untracked
    )


@pytest.mark.parametrize("work", [matte, plate, carve, bring_in])
@pytest.mark.parametrize("link", [".fourd", ".fourd/mattes", ".fourd/plates", ".fourd/hulls", ".fourd/mattes/01"])
def test_links_are_refused_and_their_targets_kept(
    ball_capture: Path, tmp_path: Path, work: Callable[[Path], None], link: str
) -> None:
    """Catches links in a downloaded capture that make fourd delete the user's own files."""
    capture = Path(shutil.copytree(ball_capture, tmp_path / "capture"))
    private = tmp_path / "private"
    files = [private / name for name in ("000000.ply", "mattes/01/000000.png", "hulls/000000.ply", ".unfinished-a.png")]
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("mine")
    (capture / link).parent.mkdir(parents=True, exist_ok=True)
    (capture / link).symlink_to(private)
    with pytest.raises(
        UserError, match=rf"{link}: expected no symbolic links in .*, got a link to .*; remove the link"
    ):
        work(capture)
    assert [file.read_text() for file in files] == ["mine"] * len(files)


def test_other_folders_may_hold_links(tmp_path: Path) -> None:
    """Catches an --out folder outside .fourd that is refused because .fourd contains a link."""
    (tmp_path / ".fourd").mkdir()
    (tmp_path / ".fourd" / "mattes").symlink_to(tmp_path)
    refuse_symlinks(tmp_path, tmp_path / "hulls")
    refuse_symlinks(tmp_path / "new", tmp_path / "new" / ".fourd")
