"""``fourd info --system``, whose output people add to reports of problems."""

from __future__ import annotations

from pathlib import Path

import pytest

from fourd.base.version import __version__
from fourd.cli.main import main
from fourd.cli.scenes.description import system
from fourd.rendering.ops.loading import load_native
from tests.baking.scenes import write_scene


def test_versions_processor_and_gpu_are_named() -> None:
    """Catches a report that lacks what a developer asks for first: versions, instruction set, CUDA and OpenGL."""
    rows = dict(system.describe_system())
    assert rows["fourd"] == __version__
    assert rows["numpy"][0].isdigit()
    assert load_native().simd_default() in rows["CPU kernels"]
    assert {"Python", "system", "torch", "processor", "CUDA", "OpenGL"} <= set(rows)
    assert all(rows.values())


def test_missing_packages_do_not_end_the_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a report that fails exactly where it is needed: without torch, OpenGL or kernels."""

    def fail(*_: object) -> None:
        raise ImportError("a library\nis missing")

    def fail_opengl() -> None:
        raise system.UserError("OpenGL: none")

    monkeypatch.setattr(system, "load_native", fail)
    monkeypatch.setattr(system, "find_spec", lambda _: None)
    monkeypatch.setattr(system, "PACKAGES", ("no-such-package",))
    monkeypatch.setattr("fourd.viewer.gl.context.offscreen_context", fail_opengl)
    rows = dict(system.describe_system())
    assert rows["no-such-package"] == "not installed"
    assert rows["CPU kernels"] == "not available: a library is missing"
    assert rows["CUDA"] == "not available: torch is not installed"
    assert rows["OpenGL"] == "not available: OpenGL: none"


def test_the_report_can_stand_before_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches --system that needs a file, or that hides the description of a file."""
    assert main(["info", "--system"]) == 0
    assert "fourd" in capsys.readouterr().out
    write_scene(tmp_path / "scene.4dv")
    assert main(["info", "--system", str(tmp_path / "scene.4dv")]) == 0
    assert "a 4D scene" in capsys.readouterr().out


def test_nothing_to_describe_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    """Catches ``fourd info`` without arguments that prints nothing."""
    assert main(["info"]) == 2
    assert "add --system" in capsys.readouterr().err
