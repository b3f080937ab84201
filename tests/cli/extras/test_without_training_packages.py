"""An installation without the extra ``fourd[train]``. Scenes play, and other commands give a one-line error that names
the extra."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from fourd.cli.main import TRAINING_PACKAGES
from tests.baking.scenes import write_scene
from tests.cli.extras.without import MAIN, run_without

ROOT = Path(__file__).parents[3]


def run_without_training_packages(*words: str) -> subprocess.CompletedProcess[str]:
    return run_without(TRAINING_PACKAGES, MAIN, *words)


def test_scenes_play(tmp_path: Path) -> None:
    """Catches a command that imports torch or another training package to render images of a .4dv file."""
    scene = tmp_path / "scene.4dv"
    write_scene(scene)
    size = ["--size", "64", "48"]
    commands = [
        ["info", str(scene)],
        ["render", str(scene), "--out", str(tmp_path / "pictures"), "--path", "orbit", *size],
        ["view", str(scene), "--headless", str(tmp_path / "view.mp4"), *size],
    ]
    for words in commands:
        done = run_without_training_packages(*words)
        assert done.returncode == 0, done.stderr[-2000:]
    assert any((tmp_path / "pictures").rglob("*.png"))
    assert (tmp_path / "view.mp4").stat().st_size > 0


@pytest.mark.parametrize(
    "words", [["train", "capture", "--out", "run"], ["make", "capture", "-o", "scene.4dv"], ["eval", "run"]]
)
def test_training_names_the_extra_in_one_line(words: list[str]) -> None:
    """Catches a traceback if a package of the extra is not installed."""
    done = run_without_training_packages(*words)
    assert done.returncode == 2
    expected = rf"fourd {words[0]}: expected the training packages, but \w+ is missing; pip install 'fourd\[train\]'\n"
    assert re.fullmatch(expected, done.stderr), done.stderr


def test_extra_lists_the_same_packages() -> None:
    """Catches a list of training packages that differs from the extra in pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    names = [re.split(r"[<>=\[]", requirement)[0] for requirement in project["optional-dependencies"]["train"]]
    assert sorted(names) == sorted(TRAINING_PACKAGES)
