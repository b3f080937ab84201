"""Numbers that the documentation quotes equal the numbers in the code.

A page marks a quoted number with an HTML comment that names its source. The rendered page does not show the comment:

    K is at most 15<!--= fourd.reconstruction.training.config:TrainConfig.layers -->.
"""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import numpy as np
import pytest
import torch

from fourd.base.cameras import look_at
from fourd.reconstruction.model import sources

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
QUOTE = re.compile(r"(?P<number>[-+]?[\d,]*\.?\d+(?:e[-+]?\d+)?)(?P<percent>%?)`?<!--= (?P<source>\S+) -->")
MARKER = "<!--="


def quotes() -> list[tuple[str, str, float, str]]:
    """Page, line, value and source of every marked number."""
    found = []
    for page in PAGES:
        for row, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
            for match in QUOTE.finditer(line):
                number = float(match["number"].replace(",", "")) / (100 if match["percent"] else 1)
                found.append((page.relative_to(ROOT).as_posix(), str(row), number, match["source"]))
    return found


def value_of(source: str) -> float:
    """The number at ``module:Name.attribute[index]``."""
    module, _, path = source.partition(":")
    value = importlib.import_module(module)
    for name, index in re.findall(r"(\w+)|\[(\d+)\]", path):
        value = getattr(value, name) if name else value[int(index)]  # type: ignore[index]
    return float(value)  # type: ignore[arg-type]


@pytest.mark.parametrize(("page", "row", "number", "source"), quotes())
def test_a_quoted_number_is_the_code_s(page: str, row: str, number: float, source: str) -> None:
    """Catches a page that keeps a constant's old value."""
    assert value_of(source) == pytest.approx(number, rel=1e-9), f"{page}:{row} quotes {number}, {source} differs"


def test_every_marker_belongs_to_a_number() -> None:
    """Catches a marker that the pattern misses, so that the marked number is not checked."""
    marked = sum(page.read_text(encoding="utf-8").count(MARKER) for page in PAGES)
    assert marked == len(quotes())
    assert marked >= 10


def test_visibility_falls_where_conventions_say() -> None:
    """Catches a wrong visibility margin or falloff, in the code or on the page. The visibility margin is two point
    spacings, and the falloff is one point spacing."""
    text = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")
    assert "exp(-max(z - surface - 2 s, 0) / s)" in text
    spacing, surface = 0.1, 3.0
    K = np.array([[50.0, 0, 16], [0, 50, 16], [0, 0, 1]])
    camera = look_at(np.array([0.0, -surface, 0]), np.zeros(3), np.array([0.0, 0, 1]), K, 32, 32)
    views = sources.SourceViews(
        torch.zeros(1, 3, 32, 32), torch.ones(1, 32, 32), torch.full((1, 32, 32), surface), (camera,)
    )
    behind = torch.tensor([0.0, 1.0, 2.0, 3.0, 4.0]) * spacing
    xyz = torch.stack([torch.zeros(5), behind, torch.zeros(5)], dim=1)
    samples = sources.sample_sources(xyz, views, None, torch.full((5,), spacing))
    expected = torch.tensor([1.0, 1.0, 1.0, np.exp(-1.0), np.exp(-2.0)], dtype=torch.float32)
    torch.testing.assert_close(samples.visibility[0], expected, atol=1e-4, rtol=1e-4)
