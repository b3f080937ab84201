"""Tests that no command replaces its input, or the files of a capture or a run.

The table is compared with the arguments of all commands, so that a new command or a new output needs an entry.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

from fourd.base.storage import StorageUrl
from fourd.cli.main import COMMANDS, main
from fourd.cli.outputs import Reads, Writes, find_mark

CASES: dict[tuple[str, str], list[str]] = {
    ("make", "out"): ["{in}", "-o", "{out}"],
    ("make", "work"): ["{in}", "-o", "scene.4dv", "--work", "{out}"],
    ("calibrate", "out"): ["{in}", "--board", "board.toml", "-o", "{out}"],
    ("calibrate", "print_board"): ["--board", "{in}", "--print-board", "{out}"],
    ("import", "words"): ["{in}", "{out}"],
    ("synth", "out"): ["{out}"],
    ("carve", "out"): ["{in}", "-o", "{out}"],
    ("mesh", "out"): ["{in}", "-o", "{out}"],
    ("fit-triangles", "out"): ["{in}", "-o", "{out}"],
    ("train", "out"): ["{in}", "--out", "{out}", "--max-steps", "5"],
    ("eval", "json"): ["{in}", "--json", "{out}"],
    ("export", "out"): ["{in}", "-o", "{out}"],
    ("pack", "out"): ["{in}", "-o", "{out}"],
    ("edit", "out"): ["{in}", "-o", "{out}", "--trim", "0:1"],
    ("render", "out"): ["{in}", "--out", "{out}", "--path", "orbit"],
    ("view", "headless"): ["{in}", "--headless", "{out}"],
    ("view", "screenshot"): ["{in}", "--screenshot", "{out}"],
    ("web", "out"): ["{in}", "-o", "{out}"],
    ("make", "web"): ["{in}", "-o", "scene.4dv", "--web", "{out}"],
    ("bench", "json"): ["--json", "{out}", "--quick"],
    ("bench", "markdown"): ["--markdown", "{out}", "--quick"],
}
"""For each output of each command, the words of a command line with it. Commands without an output have no entry."""
MORE = [
    ["eval", "run", "--scene", "{in}", "--json", "{out}"],
    ["export", "{in}", "--to", "ply", "-o", "{out}"],
    ["make", "videos", "--calibration", "{in}", "-o", "scene.4dv", "--work", "{out}"],
    ["make", "videos", "--lpips-weights", "{in}", "-o", "{out}"],
    ["import", "videos", "{out}", "--calibration", "{in}"],
    ["calibrate", "videos", "--board", "{in}", "-o", "{out}"],
    ["web", "scene.4dv", "--style", "a.yaml", "--style", "{in}", "-o", "{out}"],
    ["train", "capture", "--points-from", "{in}", "-o", "{out}"],
]


@dataclass(frozen=True)
class PathField:
    name: str
    hint: Any


def path_fields(arguments: type) -> Iterator[PathField]:
    """Yield the fields of a command's arguments that are paths or URLs, also in nested dataclasses."""
    hints = get_type_hints(arguments, include_extras=True)
    for field in fields(arguments):
        parts = set(flat(hints[field.name]))
        for part in parts:
            if isinstance(part, type) and is_dataclass(part) and part is not StorageUrl:
                yield from path_fields(part)
        if Path in parts:
            yield PathField(field.name, hints[field.name])


def flat(hint: Any) -> Iterator[Any]:
    yield hint
    for part in get_args(hint):
        if not isinstance(part, str):
            yield from flat(part)


def test_every_path_of_every_command_is_an_input_or_an_output() -> None:
    """Catches a new command, or a new argument, that nothing keeps from replacing an input."""
    found = {("import", "words")}  # its words are texts
    for command, module in COMMANDS.items():
        for field in path_fields(importlib.import_module(f"fourd.cli.{module}").Arguments):
            mark = find_mark(field.hint)
            assert isinstance(mark, Reads | Writes), f"fourd {command}: mark {field.name} with READS or WRITES"
            if isinstance(mark, Writes):
                found.add((command, field.name))
    assert found == set(CASES)


def spellings(folder: Path, name: str) -> Iterator[Path]:
    """Yield other names of the file or folder ``name`` in the current folder."""
    yield Path(name)
    yield folder / name
    yield Path(f"other/../{name}")
    yield Path("other") / ".." / name
    (folder / "link").symlink_to(name)
    yield Path("link")
    (folder / "way").symlink_to(folder)
    yield Path("way") / name
    if Path(name).is_file():
        os.link(name, "same inode")
        yield Path("same inode")


@pytest.mark.parametrize("kind", ["file", "folder"])
@pytest.mark.parametrize(
    "words", [[command, *words] for (command, _), words in CASES.items() if "{in}" in words] + MORE, ids=" ".join
)
def test_an_output_is_no_input(
    words: list[str], kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a command that replaces its input, also if the output names it in another way."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other").mkdir()
    if kind == "file":
        Path("input").write_text("content")
    else:
        Path("input").mkdir()
        Path("input", "file").write_text("content")
    for output in spellings(tmp_path, "input"):
        before = sorted(path.name for path in tmp_path.iterdir())
        assert main([{"{in}": "input", "{out}": str(output)}.get(word, word) for word in words]) == 2
        error = capsys.readouterr().err
        assert f"{output}: expected an output that is not an input, got an input" in error
        assert error.count("\n") == 1
        assert sorted(path.name for path in tmp_path.iterdir()) == before
    assert (Path("input") if kind == "file" else Path("input", "file")).read_text() == "content"


def write_products(folder: Path) -> None:
    """Write a capture and a run whose files are empty."""
    for name in ("capture/images/00", "capture/masks", "run/checkpoints", "run/hull", "run/segments/000/checkpoints"):
        (folder / name).mkdir(parents=True)
    for name in ("capture/intri.yml", "run/config.yaml", "run/segments/000/config.yaml", "run/metrics.jsonl"):
        (folder / name).write_text("content")


@pytest.mark.parametrize(
    "words",
    [[command, *words] for (command, name), words in CASES.items() if (command, name) != ("make", "work")],
    ids=" ".join,
)
@pytest.mark.parametrize(
    "output",
    ["capture/images/00", "capture/masks", "capture/intri.yml", "run/config.yaml", "run/hull", "run/checkpoints/new",
     "run/segments/000/config.yaml", "run/metrics.jsonl", "linked/images/00/000000"],
)  # fmt: skip
def test_files_of_captures_and_runs_are_not_replaced(
    words: list[str], output: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches rendered images that replace the recording, and scores that replace the config of a run."""
    monkeypatch.chdir(tmp_path)
    write_products(tmp_path)
    Path("linked").symlink_to("capture")
    Path("input").write_text("")
    assert main([{"{in}": "input", "{out}": output}.get(word, word) for word in words]) == 2
    kind = "capture" if output.startswith(("capture", "linked")) else "run"
    assert f"{output}: expected an output outside the files of a {kind}, got a path in" in capsys.readouterr().err


def test_folders_that_are_replaced_contain_no_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a page or a calibration that replaces the folder of its input."""
    monkeypatch.chdir(tmp_path)
    Path("scene.4dv").write_text("")
    assert main(["web", "scene.4dv", "-o", "."]) == 2
    assert ".: expected a folder without inputs, because it is replaced, got the folder of scene.4dv" in error(capsys)
    assert main(["calibrate", "videos", "--board", "boards/board.toml", "-o", "boards"]) == 2
    assert "boards: expected a folder without inputs" in error(capsys)


def test_other_files_are_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches measurements that replace a scene, two outputs in one file, and scenes with names that nothing reads."""
    monkeypatch.chdir(tmp_path)
    for name in ("scene.4dv", "other.4dv"):
        Path(name).write_text("")
    assert main(["bench", "--json", "scene.4dv"]) == 2
    assert "scene.4dv: expected a new file or a .json file, got another file; name another" in error(capsys)
    assert main(["bench", "--json", "a", "--markdown", "./a"]) == 2
    assert "a: expected another name for each output" in error(capsys)
    for words in (["pack", "other.4dv"], ["export", "run"], ["make", "capture"]):
        assert main([*words, "-o", "scene.4dw"]) == 2
        assert "scene.4dw: expected a name that ends in .4dv for a scene, got the suffix .4dw" in error(capsys)
    assert main(["pack", "other.4dv", "-o", "scene"]) == 2
    assert "scene: expected a name that ends in .4dv for a scene, got no suffix; write scene.4dv" in error(capsys)
    assert main(["pack", "s3://bucket/scene.4dv", "-o", "s3://bucket/scene.4dv"]) == 2
    assert "s3://bucket/scene.4dv: expected an output that is not an input" in error(capsys)
    for suffix in (".avi", ".mov", ".v2"):
        assert main(["render", "scene.4dv", "--path", "orbit", "-o", f"x{suffix}"]) == 2
        assert "expected a folder, or a video that ends in .mp4, .webm, .gif, got the suffix" in error(capsys)
    assert main(["view", "scene.4dv", "--headless", "x.avi"]) == 2
    assert "x.avi: expected a video that ends in .mp4, .webm, .gif" in error(capsys)
    assert main(["view", "scene.4dv", "--screenshot", "x.jpg"]) == 2
    assert "x.jpg: expected a name that ends in .png for an image" in error(capsys)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other.4dv", "scene.4dv"]


def test_outputs_beside_the_files_of_a_run_are_allowed(tmp_path: Path) -> None:
    """Catches a good output that is refused, because it is in the folder of a run."""
    from fourd.cli.outputs import require_distinct

    write_products(tmp_path)
    run = tmp_path / "run"
    for output in ("scene.4dv", "scores.json", "renders", "segments/000/scores.json", "segments/000"):
        require_distinct(run / output, [run])
    require_distinct(tmp_path / "capture" / ".fourd" / "hulls", [tmp_path / "capture"])
    require_distinct(tmp_path, [tmp_path / "capture"])


def error(capsys: pytest.CaptureFixture[str]) -> str:
    return capsys.readouterr().err
