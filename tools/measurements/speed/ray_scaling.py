"""Measure how the cost of ray tracing grows with the number of triangles, and plot it.

    python tools/measurements/speed/ray_scaling.py -o docs/figures/rays_scaling.png

Times are CPU seconds on one thread, because other running programs hardly affect CPU times. Each time is the median of
five calls.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import matplotlib.pyplot as plt

from fourd.benchmarks.meshes import make_mesh
from fourd.benchmarks.rays import primary_rays, random_rays
from fourd.rendering.rays import Bvh, trace
from tools.measurements import tables

COUNTS = (1_000, 4_000, 16_000, 64_000, 250_000, 1_000_000, 2_000_000)
SIDE = 512


def cpu_seconds(work: Callable[[], object], repeats: int = 5) -> float:
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return median(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", type=Path, required=True)
    arguments = parser.parse_args()
    kinds = {"primary rays": primary_rays(SIDE), "scattered rays": random_rays(SIDE * SIDE)}
    nanoseconds: dict[str, list[float]] = {name: [] for name in kinds}
    print(tables.head(["triangles", "build, ms", "refit, ms", "primary rays, M/s", "scattered rays, M/s"]))
    for count in COUNTS:
        xyz, tri = make_mesh(count)
        bvh = Bvh.build(xyz, tri, threads=1)
        build = cpu_seconds(lambda xyz=xyz, tri=tri: Bvh.build(xyz, tri, threads=1))
        refit = cpu_seconds(lambda bvh=bvh, xyz=xyz: bvh.refit(xyz, threads=1))
        for name, rays in kinds.items():
            taken = cpu_seconds(lambda bvh=bvh, xyz=xyz, rays=rays: trace(bvh, xyz, *rays, threads=1))
            nanoseconds[name].append(1e9 * taken / (SIDE * SIDE))
        rates = [f"{1e3 / nanoseconds[name][-1]:.2f}" for name in kinds]
        print(tables.row([f"{len(tri):,}", f"{1e3 * build:.1f}", f"{1e3 * refit:.1f}", *rates]), flush=True)
    figure, axes = plt.subplots(figsize=(6, 3.6), constrained_layout=True)
    for name, values in nanoseconds.items():
        axes.semilogx(COUNTS, values, marker="o", label=name)
    axes.set(xlabel="triangles", ylabel="CPU time per ray, ns", ylim=(0, None))
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(arguments.o, dpi=110)


if __name__ == "__main__":
    main()
