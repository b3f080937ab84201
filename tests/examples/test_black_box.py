"""The test runs examples/triangles/black_box.py with small images and few steps."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from tests.examples.programs import EXAMPLES, run_here


def test_fitting_through_opengl_reduces_the_error(tmp_path: Path) -> None:
    """Catches ids that do not belong to the image, and a wrong sign of the gradient. With either bug, the error does
    not decrease."""
    out = tmp_path / "pictures.png"
    printed = run_here("triangles/black_box.py", "--size", 48, "--triangles", 40, "--steps", 100, "--picture", out)
    words = printed.split()
    before, after = float(words[words.index("before,") - 1]), float(words[words.index("after") - 1])
    assert after < 0.6 * before
    with Image.open(out) as picture:
        assert picture.size == (144, 48)


def test_readme_lists_the_example() -> None:
    """Catches an example without an entry in examples/README.md."""
    assert "(triangles/black_box.py)" in (EXAMPLES / "README.md").read_text(encoding="utf-8")
