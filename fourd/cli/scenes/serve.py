"""Show a scene in the web browser of this machine."""

from __future__ import annotations

import tempfile
import webbrowser
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from fourd.baking.files.encoding import Tier
from fourd.cli.options import TIER_HELP, describe
from fourd.errors import UserError
from fourd.progress import Tracker


@dataclass(frozen=True)
class Arguments:
    """Serves a scene, or a folder that fourd web wrote, until Ctrl-C. Files outside the folder are not served."""

    scene: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="SCENE|SITE")]]
    """A .4dv file, or a folder that fourd web wrote."""
    port: int = 8000
    """Port to listen on. 0 selects a free port."""
    host: str = "127.0.0.1"
    """Address to listen on. 0.0.0.0 lets other machines connect."""
    browser: bool = True
    """Open the page in the browser."""
    tier: Annotated[Tier, describe(*TIER_HELP)] = "stream"


def run(arguments: Arguments) -> None:
    """Serve until Ctrl-C."""
    from fourd.viewer.publish.server import SiteServer
    from fourd.viewer.publish.site import is_site, write_site

    if not 0 <= arguments.port <= 65535:
        raise UserError(f"--port: expected 0 to 65535, got {arguments.port}")
    console = Console(stderr=True)
    with ExitStack() as stack:
        folder = arguments.scene
        if folder.is_dir():
            if not is_site(folder):
                raise UserError(f"{folder}: expected a .4dv file or a folder of fourd web, got another folder")
            server = stack.enter_context(SiteServer(folder, arguments.host, arguments.port))
        else:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="fourd-serve-"))) / "site"
            # The port is checked before the scene is converted.
            server = stack.enter_context(SiteServer(folder, arguments.host, arguments.port))
            write_site(arguments.scene, folder, arguments.tier, None, Tracker(console).track)
        console.print(f"{server.url}: {arguments.scene}; Ctrl-C ends", soft_wrap=True, markup=False)
        if arguments.browser:
            webbrowser.open(server.url)
        server.serve_forever()
