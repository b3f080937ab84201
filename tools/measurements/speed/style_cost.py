"""Measure how much time styles add to the drawing of an image on the CPU.

    python tools/measurements/speed/style_cost.py                      # 262,144 points at 1920 x 1080
    python tools/measurements/speed/style_cost.py scene.4dv --frame 3

Each round draws one image without a style and one image in the style, from a static camera. All rounds of one style run
before those of the next, so that the style's data stay in the caches, as they do during playback. The program prints
the median time of an image without a style and, for each style,

- the median time that the style adds,
- the median ratio of the times with and without the style,
- the time of the stylizer, which computes the style's colours and lines from the colour, depth and normal of each
  pixel; the rest of the added time is spent on the depths and normals of the points,
- the median CPU time that the style adds, summed over all threads; other running programs affect it less than the
  elapsed times above.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median

import numpy as np
import tyro

from fourd.rendering.ops.aligned import zeros_aligned
from fourd.scene.player import Player
from fourd.scene.styled.normals import add_normals
from fourd.scene.styled.player import StyledPlayer
from fourd.scene.styles import PRESETS, load_style
from tools.measurements import tables
from tools.measurements.speed.drawn_frame import DrawnFrame


@dataclass(frozen=True)
class Arguments:
    """The scene, the styles, and the number of rounds."""

    drawn: tyro.conf.OmitArgPrefixes[DrawnFrame] = field(default_factory=DrawnFrame)
    styles: tuple[str, ...] = PRESETS
    """Names of presets, or style files."""
    threads: int = 2
    """Number of threads."""
    rounds: int = 40
    """Number of rounds, each with one image without the style and one image in the style."""


@dataclass
class Times:
    """Milliseconds per image: elapsed time, CPU time of all threads, and elapsed time of the stylizer."""

    elapsed: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    stylizer: list[float] = field(default_factory=list)

    def measure(self, draw: Callable[[], object]) -> None:
        started, cpu_started = time.perf_counter(), time.process_time()
        draw()
        self.elapsed.append(1e3 * (time.perf_counter() - started))
        self.cpu.append(1e3 * (time.process_time() - cpu_started))


def main(arguments: Arguments) -> int:
    threads = arguments.threads
    frame, manifest, camera = arguments.drawn.open(is_ordered=True)
    frame = frame if frame.normals is not None else add_normals(frame, manifest)
    picture = zeros_aligned((camera.height, camera.width, 4), np.uint8)
    plain_player, plain, styled = Player(), dict[str, Times](), dict[str, Times]()
    for name in arguments.styles:
        style, player = load_style(name), StyledPlayer()
        for index in range(arguments.rounds + 1):
            if index < 2:  # drop the times of the first round, which fills the caches
                plain[name], styled[name] = Times(), Times()
            plain[name].measure(lambda: plain_player.draw(frame, camera, manifest, threads=threads, out=picture))
            styled[name].measure(
                lambda s=style, p=player: p.draw(frame, camera, manifest, s, threads=threads, out=picture)
            )
            styled[name].stylizer.append(1e3 * player.style_seconds)
    elapsed = median(duration for times in plain.values() for duration in times.elapsed)
    cpu_time = median(duration for times in plain.values() for duration in times.cpu)
    print(f"{frame.point_count:,} points, {camera.width} x {camera.height}, {threads} threads")
    print(f"without a style: {elapsed:.1f} ms, {cpu_time:.1f} ms of CPU time\n")
    titles = ["style", "added ms", "ratio to playing without a style", "stylizer ms", "added ms of CPU time"]
    print(tables.head(titles))
    for name, found in styled.items():
        bare = plain[name]
        added = median(with_style - without for with_style, without in zip(found.elapsed, bare.elapsed, strict=True))
        ratio = median(with_style / without for with_style, without in zip(found.elapsed, bare.elapsed, strict=True))
        cpu = median(with_style - without for with_style, without in zip(found.cpu, bare.cpu, strict=True))
        print(tables.row([name, f"{added:.1f}", f"{ratio:.2f}", f"{median(found.stylizer):.1f}", f"{cpu:.1f}"]))
    return 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Arguments, description=__doc__)))
