"""Show a scene, or a run while it trains, in the web browser of this machine."""

from __future__ import annotations

import platform
import tempfile
import threading
import webbrowser
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import tyro

from fourd.base.errors import UserError
from fourd.base.progress import Log, Terminal, console_log
from fourd.cli.options import TIER_HELP, PageStyles, describe, option
from fourd.cli.outputs import READS
from fourd.scene.files.encoding import Tier

if TYPE_CHECKING:
    from fourd.viewer.publish.server import SiteServer

PORTS_TRIED = 10
"""Number of successive ports that are tried if the ports are in use."""
Server = TypeVar("Server", bound="SiteServer")


@dataclass(frozen=True)
class Arguments:
    """Serves until Ctrl-C. If the scene is exported again, the page shows the new scene. The page of a run shows its
    training curves and images, and the scene of the newest checkpoint."""

    source: tyro.conf.Positional[Annotated[Path, READS, tyro.conf.arg(metavar="SCENE|RUN|SITE")]]
    """A .4dv file, a run, or a folder that fourd web has written."""
    port: int = 8000
    """Port to listen on. If another program uses it, the next free port is taken. 0 selects any free port."""
    host: str = "127.0.0.1"
    """Address to listen on. Use 0.0.0.0 to let other machines connect; the page of a run then needs a token."""
    token: Annotated[
        str | None,
        option(
            "TEXT",
            "the environment variable FOURD_TOKEN, otherwise a random token if other machines can connect",
            "Token that the page of a run needs: 16 to 128 letters, digits, '-' and '_'.",
        ),
    ] = None
    browser: bool = True
    """Open the page in the browser."""
    tier: Annotated[Tier, describe("Tier of scenes that are not packed.", *TIER_HELP)] = "stream"
    style: PageStyles = ()


def run(arguments: Arguments) -> None:
    """Serve until Ctrl-C."""
    from fourd.viewer.publish.site import is_site

    if not 0 <= arguments.port <= 65535:
        raise UserError(f"--port: expected 0 to 65535, got {arguments.port}")
    source = arguments.source
    is_run = source.is_dir() and not is_site(source)
    if is_run and not (source / "config.yaml").exists():
        raise UserError(
            f"{source}: expected a .4dv file, a run or a folder of fourd web, got another folder; a folder is a run as "
            "soon as its training starts"
        )
    if arguments.style and is_site(source):
        raise UserError(f"--style: expected a scene or a run, got the site {source}; use fourd web --style")
    if arguments.token is not None and not is_run:
        raise UserError(f"--token: expected a run, got {source}; the pages of scenes need no token")
    with ExitStack() as stack:
        server = _open_run(arguments, stack) if is_run else _open_scene(arguments, stack)
        with suppress(KeyboardInterrupt):
            server.serve_forever()


def _open_scene(arguments: Arguments, stack: ExitStack) -> SiteServer:
    """Start the server of a scene or of a site."""
    from fourd.viewer.publish.live import LiveSite
    from fourd.viewer.publish.server import SiteServer
    from fourd.viewer.publish.site import is_site
    from fourd.viewer.publish.styles import load_styles

    console, source = Terminal(stderr=True), arguments.source
    styles = load_styles(arguments.style)
    folder = source if is_site(source) else _temporary_folder(stack)
    # The port is checked before the scene is converted, because the conversion takes time.
    server = stack.enter_context(
        listen(lambda port: SiteServer(folder, arguments.host, port), arguments.port, console_log(console))
    )
    if folder != source:
        site = LiveSite(source, folder, arguments.tier, console, styles)
        stack.callback(site.stop)
        threading.Thread(target=site.watch, name="live site", daemon=True).start()
    _announce(arguments, server.url, console)
    return server


def _open_run(arguments: Arguments, stack: ExitStack) -> SiteServer:
    """Start the server of a run."""
    from fourd.viewer.publish.runs.access import Access, choose_token, is_loopback
    from fourd.viewer.publish.runs.server import RunServer
    from fourd.viewer.publish.runs.site import RunSite
    from fourd.viewer.publish.styles import load_styles

    console = Terminal(stderr=True)
    access = Access(arguments.host, choose_token(arguments.token, arguments.host))
    styles = load_styles(arguments.style)
    folder = _temporary_folder(stack)
    server = stack.enter_context(
        listen(lambda port: RunServer(folder, access, port), arguments.port, console_log(console))
    )
    site = server.site = RunSite(arguments.source, folder, arguments.tier, console, styles)
    stack.callback(site.stop)
    threading.Thread(target=site.watch, name="scene of the run", daemon=True).start()
    _announce(arguments, server.page, console)
    if not is_loopback(arguments.host):
        name = platform.node() if arguments.host in ("0.0.0.0", "") else arguments.host
        console.print(f"from other machines: {server.page_at(name)}", soft_wrap=True, highlight=False)
    return server


def listen(make_server: Callable[[int], Server], port: int, log: Log) -> Server:
    """Return a server on the first port, from ``port`` on, that no other program uses. At most PORTS_TRIED ports are
    tried. Another port than ``port`` is reported."""
    from fourd.viewer.publish.server import PortInUse

    for tried in range(port, min(port + PORTS_TRIED, 65536)):
        with suppress(PortInUse):
            server = make_server(tried)
            if tried != port:
                log(f"port {port} is in use, so this is port {tried}")
            return server
    return make_server(port)


def _announce(arguments: Arguments, page: str, console: Terminal) -> None:
    console.print(f"{page}: {arguments.source}; press Ctrl-C to stop", soft_wrap=True, markup=False)
    if arguments.browser:
        webbrowser.open(page)


def _temporary_folder(stack: ExitStack) -> Path:
    return Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="fourd-serve-"))) / "site"
