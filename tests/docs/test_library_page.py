"""The programs in docs/howto/library.md run without changes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.baking.scenes import write_scene

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "library.md"


def test_the_programs_run(tmp_path: Path, ball_capture: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a program that uses names or arguments which the library no longer has."""
    write_scene(tmp_path / "scene.4dv")
    (tmp_path / "capture").symlink_to(ball_capture)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for program in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        exec(compile(program, PAGE.name, "exec"), names)
    assert names["rgba"].shape[2] == 4  # type: ignore[attr-defined]
    assert float(names["xyz"].grad.abs().sum()) > 0  # type: ignore[attr-defined]
    assert list((tmp_path / "run").glob("checkpoints/*"))
    assert [steps for steps, _, _ in names["curve"]] == [1, 2, 3, 4, 5]  # type: ignore[attr-defined]
