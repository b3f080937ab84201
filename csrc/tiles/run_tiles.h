// Processes the tiles of an image in parallel.
#pragma once

#include <algorithm>

#include "common/team.h"

namespace fourd::tiles {

// Calls work(tile, worker) for all tiles in [first, last), in any order. A task is a group of at most kTilesPerTask
// consecutive tiles. Without groups, two threads would often write to neighbouring tiles at the same time. Pixel rows
// of neighbouring tiles share cache lines, so every write would move a cache line between the cores.
template <typename Work>
void run_tiles(Team& team, int first, int last, const Work& work) {
    constexpr int kTilesPerTask = 8, kTasksPerThread = 16;
    const int per_task = std::clamp((last - first) / (kTasksPerThread * team.size()), 1, kTilesPerTask);
    team.run((last - first + per_task - 1) / per_task, [&](int task, int worker) {
        const int begin = first + task * per_task, end = std::min(last, begin + per_task);
        for (int tile = begin; tile < end; ++tile) work(tile, worker);
    });
}

}  // namespace fourd::tiles
