// Processes the tiles of an image in parallel.
#pragma once

#include <algorithm>

#include "common/team.h"

namespace fourd::tiles {

// Calls work(tile, worker) for all tiles in [first, last), in any order. A task is a group of at most kTilesPerTask
// consecutive tiles, because pixel rows of neighbouring tiles share cache lines: if different threads wrote to
// neighbouring tiles at the same time, the cache lines would move between the cores at every write.
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
