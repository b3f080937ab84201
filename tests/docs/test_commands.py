"""The command line accepts the commands that the documentation shows."""

from __future__ import annotations

import importlib
import re
import shlex
from pathlib import Path

import pytest
import tyro

from fourd.cli.main import COMMANDS

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^```\w*\n(.*?)^```", re.DOTALL | re.MULTILINE)
PLACEHOLDERS = re.compile(r"[\[\]|<>]|\.\.\.|…")
"""Characters that mark a usage line, such as ``fourd import [FORMAT] SRC OUT``. A usage line is not a complete
command."""


def commands() -> list[tuple[str, str]]:
    """Page and command line of each complete ``fourd`` command at the start of a line in a fenced block."""
    found = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        lines = [line for block in FENCE.findall(text) for line in block.replace("\\\n", " ").splitlines()]
        for line in lines:
            command = line.removeprefix("$ ").removeprefix(".venv/bin/").split(" #")[0].rstrip()
            words = command.split()
            is_complete = command.startswith("fourd ") and len(words) > 2 and not PLACEHOLDERS.search(command)
            if is_complete and "--help" not in words and words[1].islower():
                found.append((page.relative_to(ROOT).as_posix(), command))
    return found


@pytest.mark.parametrize(("page", "command"), sorted(set(commands())))
def test_a_shown_command_parses(page: str, command: str) -> None:
    """Catches a page that shows a command or a flag that does not exist."""
    _, name, *words = shlex.split(command)
    assert name in COMMANDS, f"{page}: {command}"
    module = importlib.import_module(f"fourd.cli.{COMMANDS[name]}")
    try:
        tyro.cli(module.Arguments, args=words, config=(tyro.conf.OmitArgPrefixes,))
    except SystemExit:
        pytest.fail(f"{page}: not understood: {command}")


def test_commands_are_found() -> None:
    """Catches a pattern that finds no command. The tests would then pass for every page."""
    assert len(commands()) > 25
