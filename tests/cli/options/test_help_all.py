"""The short help of a command, the complete help, and the other words for help."""

from __future__ import annotations

import importlib

import pytest

from fourd.cli.help import rare_options
from fourd.cli.main import COMMANDS, HELP, main

LONG = ("make", "train", "import")
MAX_OPTIONS = 14


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    with pytest.raises(SystemExit) as caught:
        main(list(words))
    assert caught.value.code == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_the_complete_help_lists_every_option(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an option that neither help lists, and a rare option in the short help."""
    short, complete = printed(capsys, command, "--help"), printed(capsys, command, "--help-all")
    arguments = importlib.import_module(f"fourd.cli.{COMMANDS[command]}").Arguments
    rare = [f"--{name.replace('_', '-').replace('assignments', 'set')}" for name in rare_options(arguments)]
    assert all(option in complete for option in rare)
    listed = short.split("╭─ options")[-1]
    assert not [option for option in rare if f"│ {option} " in listed]
    assert (f"{len(rare)} more options" in " ".join(short.split())) == bool(rare)


@pytest.mark.parametrize("command", LONG)
def test_the_short_help_is_short(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """``fourd make --help`` filled several screens, in which nobody found the options that matter."""
    lines = printed(capsys, command, "--help").splitlines()
    assert sum(line.startswith(("│ -", "│ V", "│ [")) for line in lines) <= MAX_OPTIONS


def test_descriptions_are_paragraphs(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """At 80 columns, the lines of docstrings were broken a second time, which left lines of one word."""
    monkeypatch.setenv("COLUMNS", "80")
    text = printed(capsys, "make", "--help-all")
    assert " frame. (default: object)" not in [line.strip("│") for line in text.splitlines()]
    assert "it has only one frame. (default: object)" in " ".join(text.replace("│", " ").split())


def test_rare_options_still_work(capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an option that is not accepted because the short help does not list it."""
    assert main(["train", "missing", "--out", "run", "--max-steps", "1", "--seed", "x"]) == 2
    assert "--seed: expected" in capsys.readouterr().err


def test_other_words_for_help(capsys: pytest.CaptureFixture[str]) -> None:
    """``fourd help train`` and ``fourd -V`` were unknown commands."""
    assert printed(capsys, "help", "train") == printed(capsys, "train", "--help")
    assert main(["help"]) == 0
    assert capsys.readouterr().out == HELP
    assert main(["-V"]) == 0
    assert capsys.readouterr().out.startswith("fourd ")
    assert main(["help", "trian"]) == 2
    assert "did you mean 'train'?" in capsys.readouterr().err
