// Divides work into tasks in a way that does not depend on the number of threads.
#pragma once

#include <algorithm>
#include <vector>

#include "common/team.h"
#include "texture/cpu/loops.h"

namespace fourd::texture {

inline std::vector<Task> tasks_of(const Query& query) {
    std::vector<Task> tasks;
    for (std::size_t picture = 0; picture < query.pictures; ++picture) {
        for (std::size_t begin = 0; begin < query.pixels; begin += kTaskPixels) {
            tasks.push_back({picture, begin, static_cast<int>(std::min(kTaskPixels, query.pixels - begin))});
        }
    }
    return tasks;
}

// Some rows of a level, and the rows of the next finer level from which they are computed. `coarse` is the offset of
// the rows in the coarser level, and `fine` is the offset of the rows in the finer level, both in floats.
struct HalvedRows {
    std::size_t fine, coarse, count;
    int fine_width;
    bool halves_rows;
};

// Divides the rows of a level into blocks of consecutive rows, and calls work(rows) once for each block. The workers of
// the team share the blocks. The rows of all faces of all items are numbered consecutively.
template <typename Work>
void for_halved_rows(const Shape& shape, int level, Team& team, const Work& work) {
    constexpr std::size_t kFloatsPerTask = std::size_t{1} << 15;
    const int fine_width = side_at(shape.width, level - 1), fine_height = side_at(shape.height, level - 1);
    const bool halves_rows = fine_height > 1;
    const std::size_t rows = shape.items * shape.faces * side_at(shape.height, level);
    const std::size_t fine_row = static_cast<std::size_t>(fine_width) * shape.channels;
    const std::size_t row = static_cast<std::size_t>(side_at(shape.width, level)) * shape.channels;
    const std::size_t per_task = std::max<std::size_t>(1, kFloatsPerTask / row);
    team.run(static_cast<int>((rows + per_task - 1) / per_task), [&](int task, int) {
        const std::size_t begin = task * per_task, count = std::min(per_task, rows - begin);
        work(HalvedRows{begin * fine_row * (halves_rows ? 2 : 1), begin * row, count, fine_width, halves_rows});
    });
}

}  // namespace fourd::texture
