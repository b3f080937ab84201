"""Measure the time between the picture and the sound of a clap in the web player.

    python tools/measurements/web/sound_lag.py --seconds 60 --seeks 10

Chromium plays a scene of 2 s with a clap in a loop for --seconds, and then seeks --seeks times. The picture's time is
that at which the frame of the clap is drawn first. The sound's time is that at which the browser says that the sample
leaves the loudspeaker. Positive numbers are late sounds.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from fourd.viewer.publish.server import SiteServer
from fourd.viewer.publish.site import write_site
from tests.sound.claps import write_clap_scene
from tests.viewer.web.sound.listening import AT, lags_ms, listen, open_listening, seek_before_the_clap
from tools.measurements.web.pages import open_browser, serving


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--seeks", type=int, default=10)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_clap_scene(folder / "scene.4dv", at=AT)
        write_site(folder / "scene.4dv", folder / "site", "full")
        with open_browser() as browser, serving(SiteServer(folder / "site")) as server:
            for page in open_listening(browser, server.url):
                listen(page)
                page.page.get_by_role("button", name="Sound (M)").click()
                page.wait("stage.playback.sound.isPlaying")
                time.sleep(arguments.seconds)
                played = len(lags_ms(page))
                restarts = page.run("return stage.playback.sound.starts;")
                for _ in range(arguments.seeks):
                    seek_before_the_clap(page)
                lags = np.array(lags_ms(page))
                errors = np.array(page.run("return errors;"))
                delay = 1000 * page.run("return stage.playback.sound.delay;")
    heard = lags[np.isfinite(lags)]
    first, last = lags[:played][np.isfinite(lags[:played])], lags[played:]
    print(
        f"{len(heard)} claps; median lag {np.median(heard):.1f} ms, 90% within {np.percentile(abs(heard), 90):.1f} ms"
    )
    print(f"first 5: {format_lags(first[:5])}; last 5 of the loops: {format_lags(first[-5:])}")
    print(f"after seeks: {format_lags(last)}")
    print(f"starts of the sound before the seeks: {restarts}")
    print(
        f"mean delay of drawing {delay:.0f} ms; errors as the player measures them, 1st and 99th percentile: "
        f"{np.percentile(errors, 1):.1f} and {np.percentile(errors, 99):.1f} ms"
    )


def format_lags(lags: np.ndarray) -> str:
    return ", ".join(f"{lag:.0f}" for lag in lags) + " ms"


if __name__ == "__main__":
    main()
