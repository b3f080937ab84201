"""How ``--background`` is understood."""

from __future__ import annotations

from pathlib import Path

import pytest

from fourd.cli.main import main
from fourd.cli.runs.train import Arguments, overlaid
from fourd.errors import UserError


def words(background: str | None, config: Path | None = None) -> Arguments:
    return Arguments(Path("capture"), Path("run"), background=background, config=config, max_steps=1)


@pytest.mark.parametrize("way", ["ngp", "sfm"])
def test_a_way_takes_the_place_of_a_files_points(way: str, tmp_path: Path) -> None:
    """Catches a flag that the config file's own points overrule in silence."""
    (tmp_path / "a.yaml").write_text("background: {seeds: own.ply, seeding: sfm}\n")
    background = overlaid(words(way, tmp_path / "a.yaml")).background
    assert background.seeding == way
    assert background.seeds is None


def test_points_of_your_own_are_a_ply(tmp_path: Path) -> None:
    """Catches a file mistaken for a way, and one that is refused for how it is called."""
    assert overlaid(words("dir/own.PLY")).background.seeds == Path("dir/own.PLY")
    (tmp_path / "own").write_text("ply\n")
    assert overlaid(words(str(tmp_path / "own"))).background.seeds == tmp_path / "own"


def test_what_is_not_said_stays(tmp_path: Path) -> None:
    """Catches a flag that was not given and still changes the config file's choice."""
    (tmp_path / "a.yaml").write_text("background: {seeding: sfm, points: 5, radiance: {steps: 7}}\n")
    background = overlaid(words(None, tmp_path / "a.yaml")).background
    assert (background.seeding, background.points, background.radiance.steps) == ("sfm", 5, 7)
    assert overlaid(words(None)).background.seeding == "ngp"


def test_neither_a_way_nor_a_file_is_refused() -> None:
    """Catches a typing mistake that is looked for as a file once the mattes are made."""
    with pytest.raises(UserError, match=r"--background: expected ngp, sfm or a PLY file, got 'nerf'; see .* --help$"):
        overlaid(words("nerf"))


@pytest.mark.parametrize("command", ["train", "make"])
def test_both_commands_say_so(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches one of them that takes the flag otherwise."""
    assert main([command, str(tmp_path), "-o", str(tmp_path / "out"), "--scene", "full", "--background", "nerf"]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"fourd {command}: --background: expected ngp, sfm or a PLY file, got 'nerf'")
    assert told.count("\n") == 1


def test_a_field_that_cannot_be_is_refused_with_its_key(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("background: {radiance: {levels: 0}}\n")
    with pytest.raises(UserError, match=r"a\.yaml.*radiance.*levels: expected 1 to 32, got 0"):
        overlaid(words(None, tmp_path / "a.yaml"))
