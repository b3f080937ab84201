"""The example programs in README.md run without changes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from PIL import Image

from tests.baking.scenes import write_scene

README = Path(__file__).parents[1] / "README.md"


def test_the_library_example_runs() -> None:
    """Catches a README example that no longer runs after a change of the library. Programmers try this example
    first."""
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    example = next(block for block in blocks if "render_points" in block)
    names: dict[str, object] = {}
    exec(compile(example, "README.md", "exec"), names)
    gradient = names["xyz"].grad  # type: ignore[attr-defined]
    assert gradient is not None
    assert float(gradient.abs().sum()) > 0


def test_the_examples_of_playing_a_scene_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches README examples that use names that the library no longer has. The second example uses variables of the
    first example."""
    write_scene(tmp_path / "scene.4dv")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    names: dict[str, object] = {}
    for example in blocks:
        if "scene" in example:
            exec(compile(example, "README.md", "exec"), names)
    assert names["rgba"].shape[2] == 4  # type: ignore[attr-defined]
    assert names["rgba"].any()  # type: ignore[attr-defined]


@pytest.mark.parametrize("link", re.findall(r"\]\(((?:docs|configs|tools)/[^)]*)\)", README.read_text()))
def test_links_lead_somewhere(link: str) -> None:
    """Catches a link in README.md to a page, a heading or an image that was renamed or never committed."""
    name, _, anchor = link.partition("#")
    assert (README.parent / name).is_file()
    if anchor:
        headings = re.findall(r"^#+ (.+)$", (README.parent / name).read_text(encoding="utf-8"), re.MULTILINE)
        assert anchor in {re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


def test_animations_are_small() -> None:
    """Catches an animation that takes seconds to load, or that shows only one image."""
    for name in re.findall(r"\((docs/figures/\w+\.webp)\)", README.read_text()):
        path = README.parent / name
        assert path.stat().st_size < 1.5e6, name
        with Image.open(path) as image:
            assert getattr(image, "n_frames", 1) > 20, name
