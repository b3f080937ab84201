"""Show a scene in the web browser of this machine."""

from __future__ import annotations

import tempfile
import threading
import webbrowser
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from fourd.baking.files.encoding import Tier
from fourd.cli.options import TIER_HELP, PageStyles, describe
from fourd.errors import UserError
from fourd.progress import Terminal


@dataclass(frozen=True)
class Arguments:
    """Serves until Ctrl-C. If the scene is exported again or training writes a checkpoint, the page shows the new
    scene."""

    source: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="SCENE|RUN|SITE")]]
    """A .4dv file, a run, or a folder that fourd web has written."""
    port: int = 8000
    """Port to listen on. 0 selects a free port."""
    host: str = "127.0.0.1"
    """Address to listen on. 0.0.0.0 lets other machines connect."""
    browser: bool = True
    """Open the page in the browser."""
    tier: Annotated[Tier, describe("Tier of scenes that are not packed.", *TIER_HELP)] = "stream"
    style: PageStyles = ()


def run(arguments: Arguments) -> None:
    """Serve until Ctrl-C."""
    from fourd.viewer.publish.live import LiveSite
    from fourd.viewer.publish.server import SiteServer
    from fourd.viewer.publish.site import is_site
    from fourd.viewer.publish.styles import load_styles

    if not 0 <= arguments.port <= 65535:
        raise UserError(f"--port: expected 0 to 65535, got {arguments.port}")
    console, source = Terminal(stderr=True), arguments.source
    if source.is_dir() and not is_site(source) and not (source / "config.yaml").exists():
        raise UserError(f"{source}: expected a .4dv file, a run or a folder of fourd web, got another folder")
    if arguments.style and is_site(source):
        raise UserError(f"--style: expected a scene or a run, got the site {source}; use fourd web --style")
    styles = load_styles(arguments.style)
    with ExitStack() as stack:
        folder = source
        if not is_site(source):
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="fourd-serve-"))) / "site"
        # The conversion of the scene takes time, so the port is checked first.
        server = stack.enter_context(SiteServer(folder, arguments.host, arguments.port))
        if folder != source:
            site = LiveSite(source, folder, arguments.tier, console, styles)
            stack.callback(site.stop)
            threading.Thread(target=site.watch, name="live site", daemon=True).start()
        console.print(f"{server.url}: {source}; press Ctrl-C to stop", soft_wrap=True, markup=False)
        if arguments.browser:
            webbrowser.open(server.url)
        with suppress(KeyboardInterrupt):
            server.serve_forever()
