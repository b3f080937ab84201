"""MkDocs hooks that generate pages while the site is built.

- ``reference/cli.md`` contains the ``--help-all`` of each command.
- ``examples.md`` contains the programs in ``examples/``.
- ``contributing.md`` and ``changelog.md`` are copies of the files at the top of the repository.
- ``player/`` contains the modules of the web player. Pages with scenes load them, and ``scenes/page.js``.
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
    from jinja2 import Environment
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
HELP_COLUMNS = "84"
"""Width of the help texts in characters."""
SCENES = "scenes"
"""Folder of the scenes that pages play, relative to docs/ and to the site."""

CLI_HEAD = """# Commands

This page is generated from `fourd --help` and `fourd COMMAND --help-all`. Exit codes are 0 on success, 2 if the
input is wrong and 1 on an internal error.
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


def on_env(env: Environment, config: MkDocsConfig, files: Files) -> None:
    """Add the player to the site, whose folder is already empty at this time."""
    _import_from_repository()
    from fourd.viewer.publish.site import copy_modules

    copy_modules(Path(config.site_dir))


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Name the dialog of the search, and load the player in the pages with scenes. Addresses are relative, so that the
    site can be published below any address."""
    output = output.replace(
        'role="dialog">', 'role="dialog" aria-label="Search">', 1
    )  # The theme's dialog has no name.
    if '<div class="scene"' not in output:
        return output
    from mkdocs.utils import get_relative_url

    from fourd.viewer.publish.site import loaded_modules

    modules = loaded_modules(Path(config.site_dir))
    # Preload links in a template, which scenes/page.js puts into the page when it is drawn. Links in the head would
    # delay the style sheets and the picture that the page shows first.
    links = (get_relative_url(name, page.url) for name in modules)
    head = [
        '<template id="player-modules">',
        *(f'<link rel="modulepreload" href="{link}">' for link in links),
        "</template>",
    ]
    head.append(f'<script type="module" src="{get_relative_url(f"{SCENES}/page.js", page.url)}"></script>')
    return output.replace("</head>", "\n".join([*head, "</head>"]), 1)


def cli_reference() -> str:
    """Return the page with the help text of every command."""
    _import_from_repository()
    from fourd.cli.main import COMMANDS

    sections = [CLI_HEAD, _fenced(command_help())]
    for command in COMMANDS:
        sections.append(f"## fourd {command}\n\n{_fenced(command_help(command))}")
    return "\n".join(sections)


def command_help(command: str | None = None) -> str:
    """Return the output of ``fourd COMMAND --help-all``, or of ``fourd --help`` if ``command`` is None, at a fixed
    width and without colours."""
    from fourd.cli.main import main

    printed = io.StringIO()
    arguments = [] if command is None else [command]
    with _plain_terminal(), contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        main([*arguments, "--help-all"])
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
    text = re.sub(r"\]\((?:\.\./)*docs/", "](", text)
    # Links to files outside docs/, which are not part of the site, are replaced by their link text.
    return re.sub(r"\[([^\]]+)\]\((?!https?:|#)([^)#]+\.(?:py|yaml|toml|h|sh))\)", r"\1", text)


def _import_from_repository() -> None:
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))


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
