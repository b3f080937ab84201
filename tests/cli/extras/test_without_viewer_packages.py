"""An installation without the extra ``fourd[viewer]``, for example on a server. Scenes are rendered and published, and
a window is refused with a one-line error that names the extra."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from fourd.cli.main import VIEWER_PACKAGES
from tests.baking.scenes import write_scene
from tests.cli.extras.without import MAIN, run_without

ROOT = Path(__file__).parents[3]
IMPORTS = """
import importlib, pkgutil
import fourd.viewer, fourd.viewer.gl, fourd.viewer.output, fourd.viewer.publish, fourd.viewer.rendering
import fourd.viewer.headless
for package in (fourd.viewer.gl, fourd.viewer.output, fourd.viewer.publish, fourd.viewer.rendering):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
"""


def run_blocked(program: str, *words: str) -> subprocess.CompletedProcess[str]:
    return run_without(VIEWER_PACKAGES, program, *words)


def test_rendering_and_publishing_import_no_window_toolkit() -> None:
    """Catches an import of glfw or imgui in code that runs without a window."""
    done = run_blocked(IMPORTS)
    assert done.returncode == 0, done.stderr[-2000:]


def test_scenes_are_rendered_and_published(tmp_path: Path) -> None:
    """Catches a command that needs a window toolkit although it opens no window."""
    scene = tmp_path / "scene.4dv"
    write_scene(scene)
    size = ["--size", "64", "48"]
    commands = [
        ["info", str(scene)],
        ["render", str(scene), "--out", str(tmp_path / "pictures"), "--path", "orbit", *size],
        ["view", str(scene), "--screenshot", str(tmp_path / "view.png"), *size],
        ["web", str(scene), "-o", str(tmp_path / "site")],
    ]
    for words in commands:
        done = run_blocked(MAIN, *words)
        assert done.returncode == 0, done.stderr[-2000:]
    assert (tmp_path / "view.png").stat().st_size > 0
    assert (tmp_path / "site" / "index.html").is_file()


def test_a_window_names_the_extra_in_one_line(tmp_path: Path) -> None:
    """Catches a traceback if the packages for windows are not installed."""
    write_scene(tmp_path / "scene.4dv")
    done = run_blocked(MAIN, "view", str(tmp_path / "scene.4dv"))
    assert done.returncode == 2
    expected = (
        r"fourd view: expected the packages for windows, but \w+ is missing; pip install 'fourd\[viewer\]', "
        r"or add --headless FILE.mp4 or --screenshot FILE.png\n"
    )
    assert re.fullmatch(expected, done.stderr), done.stderr


def test_the_extra_lists_the_same_packages() -> None:
    """Catches a list of packages that differs from the extra in pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    names = {re.split(r"[<>=\[]", each)[0].replace("-", "_") for each in project["optional-dependencies"]["viewer"]}
    # A window without sounddevice plays scenes without sound.
    assert names - {"sounddevice"} == set(VIEWER_PACKAGES)
    assert not names & {re.split(r"[<>=\[]", each)[0].replace("-", "_") for each in project["dependencies"]}


def test_all_has_every_other_extra() -> None:
    """Catches an extra that ``fourd[all]`` omits."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    listed = re.fullmatch(r"fourd\[(.*)\]", extras["all"][0])
    assert listed is not None
    assert sorted(listed[1].split(",")) == sorted(extras.keys() - {"all"})


@pytest.mark.parametrize("name", ["glfw", "imgui-bundle"])
def test_windows_packages_are_pinned(name: str) -> None:
    """Catches a package of the extra whose version the tests do not fix."""
    assert re.search(rf"^{name}==", (ROOT / "constraints.txt").read_text(), re.MULTILINE)
