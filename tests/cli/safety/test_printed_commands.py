"""Tests of the commands that fourd prints: they can be copied to a shell as they are."""

from __future__ import annotations

import ast
import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from fourd.base.errors import command_line
from fourd.cli.main import COMMANDS, main

ROOT = Path(__file__).parents[3]
VALUE = "\0"
COMMAND = re.compile(rf"\bfourd (?:{'|'.join(COMMANDS)})\b[^;,)`\n{VALUE}]*{VALUE}")
NEXT = re.compile(r"next: (fourd .*)")


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the line number and the text of each f-string and of each sum with a text. Values in them become VALUE."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.JoinedStr):
            parts = [part.value if isinstance(part, ast.Constant) else VALUE for part in node.values]
            yield node.lineno, "".join(map(str, parts))
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add) and isinstance(node.left, ast.Constant):
            yield node.lineno, f"{node.left.value}{VALUE}"


def test_every_printed_command_is_quoted() -> None:
    """Catches a command with a path that a shell would split at spaces. Such texts need
    fourd.base.errors.command_line."""
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text.replace(VALUE, '{}')}"
        for folder in ("fourd", "viewer", "examples", "tools")
        for path in sorted((ROOT / folder).rglob("*.py"))
        for line, text in texts(path)
        if COMMAND.search(text)
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("name", ["my cap (1)", "it's [1]", "$HOME", "a;b", "plain", "Ü", "*", "#1", "-o", "~"])
def test_words_survive_the_shell(name: str) -> None:
    """Catches a character that a shell interprets, and a path that a command would take for an option."""
    line = command_line("fourd", "check", Path(name), "-o", "scene.4dv")
    words = shlex.split(line, comments=True)
    assert words[:2] == ["fourd", "check"]
    assert Path(words[2]) == Path(name)
    assert not words[2].startswith("-")
    assert words[3:] == ["-o", "scene.4dv"]
    assert shlex.split(command_line("fourd", "train", "--method", "x y")) == ["fourd", "train", "--method", "x y"]


def test_commands_on_windows_are_quoted_for_its_shell(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches single quotes, which are ordinary characters on Windows."""
    monkeypatch.setattr("sys.platform", "win32")
    assert command_line("fourd", "check", "my cap (1)") == 'fourd check "my cap (1)"'


@pytest.mark.slow
def test_the_next_commands_work_in_a_folder_with_spaces(
    ball_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a printed command that ends in an error because of the name of a folder."""
    monkeypatch.setenv("COLUMNS", "80")
    folder = tmp_path / "take [2] of 3"
    folder.mkdir()
    monkeypatch.chdir(folder)
    shutil.copytree(ball_capture, "my cap (1)")
    small = ["--max-steps", "2", "--points", "300", "--scale", "0.5", "--workers", "1"]

    def run(words: list[str], *more: str) -> list[str]:
        """Run a command, and return the words of the next command that it prints."""
        assert main([*words, *more]) == 0
        printed = capsys.readouterr()
        found = NEXT.findall(printed.out + printed.err)
        assert len(found) == 1
        return shlex.split(found[0])[1:]

    made = run(run(["check", "my cap (1)"]), *small)
    assert made[0] == "view"
    trained = run(["train", "my cap (1)", "-o", "my run", "--test-views", "02"], *small)
    assert trained == ["view", "my run"]
    viewed = run(["export", "my run", "-o", "my scene.4dv"])
    assert main([*viewed, "--screenshot", "view.png", "--renderer", "cpu", "--size", "32", "32"]) == 0
    served = run(["web", "my scene.4dv", "-o", "my site"])
    assert served == ["serve", "my site"]
    assert run(["pack", "my scene.4dv", "-o", "it's small.4dv"]) == ["view", "it's small.4dv"]
