"""``--help`` of every command."""

from __future__ import annotations

import pytest

from fourd.cli.main import COMMANDS, main


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_real_defaults(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an option whose default is decided later and shown as None."""
    with pytest.raises(SystemExit) as caught:
        main([command, "--help"])
    assert caught.value.code == 0
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "default: None" not in text
    assert "{None}" not in text
    if "--frames" in text and command != "synth":
        assert "--frames A:B[:S] Frames A to B, B excluded, every S-th" in text
