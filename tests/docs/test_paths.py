"""All files, modules and packages that the documentation names must exist."""

from __future__ import annotations

import importlib
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "examples" / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
TOP = ("fourd", "viewer", "csrc", "configs", "examples", "tools", "tests", "docs")
PATH = re.compile(rf"`((?:{'|'.join(TOP)})/[\w./-]*)`")
DEFINITION = re.compile(r"`((?:fourd|viewer|tools)/[\w/]+\.py)`, ((?:`[\w.]+`(?:, | and )?)+)")
"""Pattern for a file followed by names that the file defines, such as `fourd/a.py`, `function` and `Class.method`."""
NAME = re.compile(r"`(fourd(?:\.\w+)+)(?:\(\))?`")
LINK = re.compile(r"\]\(([^)\s]+)\)")
FENCE = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
PLACEHOLDER = re.compile(r"[A-Z]{3,}|\*|saxpy|\.pyi$")
"""Placeholders, the example kernel of docs/guides/adding_a_kernel.md, and files that the build generates."""
GENERATED = {"docs/examples.md", "docs/contributing.md", "docs/changelog.md", "docs/reference/cli.md"}
"""Pages that exist only in the built site."""


def mentions(pattern: re.Pattern[str]) -> list[tuple[str, Any]]:
    """Page and matching text, for every match outside fenced blocks."""
    found = set()
    for page in PAGES:
        text = FENCE.sub("", page.read_text(encoding="utf-8"))
        found |= {(page.relative_to(ROOT).as_posix(), match) for match in pattern.findall(text)}
    return sorted(found)


@pytest.mark.parametrize(("page", "path"), mentions(PATH))
def test_a_named_file_exists(page: str, path: str) -> None:
    """Catches a page that names a file which was moved."""
    if not PLACEHOLDER.search(path):
        assert (ROOT / path).exists(), f"{page} names {path}"


@pytest.mark.parametrize(("page", "mention"), mentions(DEFINITION))
def test_a_named_file_defines_what_the_page_names(page: str, mention: tuple[str, str]) -> None:
    """Catches a function or class that was renamed or moved to another file."""
    path, names = mention
    source = (ROOT / path).read_text(encoding="utf-8")
    for name in re.findall(r"\w+", names.replace("`", " ").replace(" and ", " ")):
        assert re.search(rf"(?:def|class) {name}\b", source), f"{page}: {path} does not define {name}"


@pytest.mark.parametrize(("page", "name"), mentions(NAME))
def test_a_named_object_exists(page: str, name: str) -> None:
    """Catches a page that names a module, function or class which was renamed."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            assert hasattr(found, part), f"{page} names {name}"
            found = getattr(found, part)
        return
    pytest.fail(f"{page} names {name}")


@pytest.mark.parametrize(("page", "link"), mentions(LINK))
def test_a_link_leads_to_a_file(page: str, link: str) -> None:
    """Catches links to pages and images that were renamed or never committed."""
    target = link.partition("#")[0]
    if target and "://" not in target:
        path = ((ROOT / page).parent / target).resolve()
        assert path.exists() or path.relative_to(ROOT).as_posix() in GENERATED, f"{page} links to {link}"


def test_the_overview_links_every_page() -> None:
    """Catches a page that is reachable neither from the README nor from the overview, to which the README links, and a
    lab page that the index of the lab notes omits."""
    readme, overview = ROOT / "README.md", ROOT / "docs" / "start" / "overview.md"
    index = ROOT / "docs" / "lab" / "index.md"
    linked = {page: _links(page) for page in (readme, overview, index)}
    assert overview in linked[readme]
    pages = sorted((ROOT / "docs").rglob("*.md"))
    lab = [page for page in pages if page.parent == index.parent and page != index]
    reachable = linked[readme] | linked[overview]
    assert [page for page in pages if page not in lab and page not in reachable] == []
    assert [page for page in lab if page not in linked[index]] == []


def _links(page: Path) -> set[Path]:
    """The files to which a page links."""
    targets = (link.partition("#")[0] for link in LINK.findall(page.read_text(encoding="utf-8")))
    return {(page.parent / target).resolve() for target in targets if target and "://" not in target}


def test_architecture_lists_the_packages_in_the_order_of_imports() -> None:
    """Catches a package that is missing in the table, and an order of packages that differs from import-linter's
    settings."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    layers = settings["tool"]["importlinter"]["contracts"][0]["layers"]
    expected = [re.findall(r"\w+", layer) for layer in layers]
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = page.partition("## Packages")[2].partition("\n## ")[0]
    rows = [re.findall(r"`(\w+)`", line.split("|")[1]) for line in table.splitlines() if line.startswith("| `")]
    assert rows == expected
