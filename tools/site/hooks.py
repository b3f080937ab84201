"""MkDocs hooks that generate pages while the site is built.

- ``reference/cli.md`` contains the ``--help`` of each command.
- ``examples.md`` contains the programs in ``examples/``.
- ``contributing.md`` and ``changelog.md`` are copies of the files at the top of the repository.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files

ROOT = Path(__file__).parents[2]
HELP_COLUMNS = "84"
"""Width of the help texts in characters."""

CLI_HEAD = """# Commands

This page is generated from `fourd --help` and `fourd COMMAND --help`. Exit codes are 0 on success, 2 if the input is
wrong and 1 on an internal error.
"""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages to the site."""
    from mkdocs.structure.files import File

    pages = {
        "reference/cli.md": cli_reference(),
        "examples.md": examples_page(),
        "contributing.md": repository_page("CONTRIBUTING.md"),
        "changelog.md": repository_page("CHANGELOG.md"),
    }
    for uri, text in pages.items():
        files.append(File.generated(config, uri, content=text))
    return files


def cli_reference() -> str:
    """Return the page with the help text of every command."""
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))
    from fourd.cli.main import COMMANDS

    sections = [CLI_HEAD, _fenced(command_help())]
    for command in COMMANDS:
        sections.append(f"## fourd {command}\n\n{_fenced(command_help(command))}")
    return "\n".join(sections)


def command_help(command: str | None = None) -> str:
    """Return the output of ``fourd COMMAND --help``, or of ``fourd --help`` if ``command`` is None, at a fixed width
    and without colours."""
    from fourd.cli.main import main

    printed = io.StringIO()
    arguments = [] if command is None else [command]
    with _plain_terminal(), contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        main([*arguments, "--help"])
    return printed.getvalue().rstrip()


def examples_page() -> str:
    """Return examples/README.md followed by the source code of every program."""
    sections = [repository_page("examples/README.md")]
    for path in sorted((ROOT / "examples").glob("*.py")):
        sections.append(f"## {path.name}\n\n```python\n{path.read_text(encoding='utf-8')}```\n")
    return "\n".join(sections)


def repository_page(name: str) -> str:
    """Return a Markdown file from the top of the repository, with links made relative to docs/."""
    text = (ROOT / name).read_text(encoding="utf-8")
    text = re.sub(r"\]\(docs/", "](", text)
    # Links to files outside docs/, which are not part of the site, are replaced by their link text.
    return re.sub(r"\[([^\]]+)\]\((?!https?:|#)([^)#]+\.(?:py|yaml|toml|h|sh))\)", r"\1", text)


@contextlib.contextmanager
def _plain_terminal() -> Iterator[None]:
    settings = {"COLUMNS": HELP_COLUMNS, "NO_COLOR": "1", "TERM": "dumb"}
    before = {name: os.environ.get(name) for name in settings}
    os.environ.update(settings)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _fenced(text: str) -> str:
    return f"```text\n{text}\n```\n"
