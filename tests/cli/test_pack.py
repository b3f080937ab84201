"""The command `fourd pack`: its files, its output and its error messages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fourd.cli.main import main
from fourd.scene import SceneReader, SceneWriter, open_scene
from tests.baking.packing.test_pack import natural_frame
from tests.baking.scenes import manifest, write_scene


@pytest.fixture
def scene(tmp_path: Path, rng: np.random.Generator) -> Path:
    with SceneWriter(tmp_path / "scene.4dv", manifest(6, 3)) as writer:
        for index in range(3):
            writer.add_frame(index, natural_frame(800, 6, rng))
    return tmp_path / "scene.4dv"


def pack(*words: object) -> int:
    """Run `fourd pack` and return its exit code."""
    return main(["pack", *map(str, words)])


def test_pack_writes_a_smaller_scene_and_prints_sizes(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a tier that is ignored, and reported sizes that differ from the sizes in the file."""
    sizes = {}
    for tier in ("full", "stream", "video", "light"):
        out = tmp_path / f"{tier}.4dv"
        assert pack(scene, "-o", out, "--tier", tier) == 0
        assert "positions, radii, densities" in capsys.readouterr().err
        encoding = SceneReader(out).manifest.encoding
        assert encoding is not None
        assert encoding.tier == tier
        sizes[tier] = out.stat().st_size
        assert main(["info", str(out)]) == 0
        assert f"packed, tier {tier}" in capsys.readouterr().out
    assert sizes["light"] < sizes["stream"] < sizes["full"] < scene.stat().st_size


def test_a_packed_scene_can_be_packed_again(scene: Path, tmp_path: Path) -> None:
    """Catches a packed scene that cannot be packed again."""
    assert pack(scene, "-o", tmp_path / "full.4dv") == 0
    assert pack(tmp_path / "full.4dv", "-o", tmp_path / "light.4dv", "--tier", "light") == 0
    assert pack(tmp_path / "light.4dv", "-o", tmp_path / "again.4dv", "--tier", "stream") == 0
    assert open_scene(tmp_path / "again.4dv").manifest.view_count == 0


def test_the_connection_chooses_the_tier(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a chosen tier and level that need more Mbit/s than the connection has."""
    chosen = []
    for mbps in (1000, 1.7, 0.82):
        out = tmp_path / f"{mbps}.4dv"
        assert pack(scene, "-o", out, "--max-mbps", mbps) == 0
        line = next(line for line in capsys.readouterr().err.splitlines() if line.startswith("--max-mbps"))
        assert float(line.split(": ")[2].split()[0]) <= mbps
        encoding = SceneReader(out).manifest.encoding
        assert encoding is not None
        chosen.append(encoding.tier)
        assert ("the next finer level needs" in line) == (mbps < 1000)
    assert chosen == ["full", "stream", "light"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ("--max-mbps", "0.001"),
            r"--max-mbps: expected at least \d+\.\d Mbit/s for .*scene.4dv at 24 frames per second",
        ),
        (("--max-mbps", "0"), "--max-mbps: expected a number of megabits per second above 0, got 0.0"),
        (("--tier", "tiny"), "tier"),
    ],
)
def test_bad_options_are_named(
    tmp_path: Path, words: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a traceback, and a file that is written although the options are wrong."""
    import re

    write_scene(tmp_path / "scene.4dv")
    assert pack(tmp_path / "scene.4dv", "-o", tmp_path / "out.4dv", *words) == 2
    assert re.search(message, capsys.readouterr().err)
    assert not (tmp_path / "out.4dv").exists()


def test_other_files_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a traceback for a file that is not a scene."""
    (tmp_path / "notes.txt").write_text("no scene")
    assert pack(tmp_path / "notes.txt", "-o", tmp_path / "out.4dv") == 2
    assert "expected a complete .4dv scene" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
