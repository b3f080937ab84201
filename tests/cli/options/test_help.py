"""The text of ``--help`` for every command, and the errors for invalid rendering options."""

from __future__ import annotations

import pytest

from fourd.cli.main import COMMANDS, main


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_real_defaults(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an option whose default is computed later and is shown as None."""
    with pytest.raises(SystemExit) as caught:
        main([command, "--help"])
    assert caught.value.code == 0
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "default: None" not in text
    assert "{None}" not in text
    if "--frames" in text and command != "synth":
        assert "--frames A:B[:S] Every S-th frame from A to B, B excluded" in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--layers", "65"], "--layers: expected 1 to 64, got 65"),
        (["--background", "0", "0", "2"], "--background: expected three numbers from 0 to 1, got (0.0, 0.0, 2.0)"),
        (["--size", "8", "600"], "--size: expected 16 to 16384 pixels, got 8 x 600"),
        (["--steps", "0"], "--steps: expected at least 1, got 0"),
        (["--fps", "nan"], "--fps: expected more than 0 and at most 1000, got nan"),
        (["--size", "8"], "--size: expected W H, got '8'"),
    ],
)
@pytest.mark.parametrize("command", [["render", "a.4dv", "--out", "x", "--path", "orbit"], ["view", "a.4dv"]])
def test_bad_rendering_options_are_one_line(
    command: list[str], words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches an invalid value that a command accepts and that makes the renderer fail."""
    assert main([*command, *words]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"fourd {command[0]}: {message}")
    assert error.count("\n") == 1


def test_options_that_printing_does_not_need_are_not_called_required(capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a help text of ``fourd calibrate`` in which -o and VIDEOS are always required, although --print-board
    needs neither.
    """
    with pytest.raises(SystemExit):
        main(["calibrate", "--help"])
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert text.count("(required, except with --print-board)") == 2
    assert text.count("(required") == 3
