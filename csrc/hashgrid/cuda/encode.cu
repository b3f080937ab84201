#include "hashgrid/cuda/encode.h"

#include "device/clear.h"
#include "device/executor.h"

namespace fourd::hashgrid::cuda {
namespace {

// The levels and points that a kernel processes. Kernels process one level after another, so that threads that run at
// the same time share the cached table entries of one level (Mueller et al. 2022, sec. 4).
struct Grid {
    Level levels[kMaxLevels];
    int level_count, features;
    const float* table;
    const float* coordinates;
    std::size_t count;

    explicit Grid(const Query& query)
        : level_count(query.level_count),
          features(query.features),
          table(query.table),
          coordinates(query.coordinates),
          count(query.count) {
        for (int l = 0; l < level_count; ++l) levels[l] = query.levels[l];
    }
};

struct Location {
    const Level& level;
    std::size_t row;  // Offset, in the array of encodings, of the point's first feature of the level.
    const float* coordinates;
    std::size_t point;
    Cell cell;

    FOURD_DEVICE Location(const Grid& grid, std::size_t index) : level(grid.levels[index / grid.count]) {
        point = index % grid.count;
        row = (point * grid.level_count + index / grid.count) * grid.features;
        coordinates = grid.coordinates + 3 * point;
        cell = cell_of(level, interpolate_axis(level, coordinates[0]), interpolate_axis(level, coordinates[1]),
                       interpolate_axis(level, coordinates[2]));
    }

    // Returns the offset, in the table, of the entry at a corner of the cell.
    FOURD_DEVICE std::size_t at(const Grid& grid, int corner) const {
        return (level.first + cell.entry[corner]) * grid.features;
    }

    FOURD_DEVICE float weight(int corner) const {
        return cell.weight[corner / 2] * (corner % 2 ? cell.fraction : 1.0f - cell.fraction);
    }
};

struct Encode {
    Grid grid;
    float* out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Location location(grid, index);
        // The loop processes one feature at a time, because an array of all features would have run-time indices, and
        // the compiler would place it in local memory and not in registers.
        for (int f = 0; f < grid.features; ++f) {
            float sum = 0.0f;
            for (int corner = 0; corner < kCorners; ++corner) {
                sum += location.weight(corner) * grid.table[location.at(grid, corner) + f];
            }
            out[location.row + f] = sum;
        }
    }
};

struct EncodeBackward {
    Grid grid;
    const float* gradient;
    float* to_table;        // Null if the gradient of the table is not needed.
    float* to_coordinates;  // Null if the gradient of the coordinates is not needed.

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Location location(grid, index);
        const float* from = gradient + location.row;
        float grad_corner[kCorners];  // For each corner, the dot product of its entry and the point's gradient.
        for (int corner = 0; corner < kCorners; ++corner) {
            const std::size_t at = location.at(grid, corner);
            grad_corner[corner] = 0.0f;
            for (int f = 0; f < grid.features; ++f) {
                if (to_table) device::atomic_add(to_table + at + f, location.weight(corner) * from[f]);
                if (to_coordinates) grad_corner[corner] += from[f] * grid.table[at + f];
            }
        }
        if (!to_coordinates) return;
        float slopes[3] = {};
        add_slopes(location.level, location.coordinates, grad_corner, slopes);
        for (int axis = 0; axis < 3; ++axis)
            device::atomic_add(to_coordinates + 3 * location.point + axis, slopes[axis]);
    }
};

}  // namespace

void encode(const Query& query, float* out, void* stream) {
    device::Executor(stream).for_each(query.count * query.level_count, Encode{Grid(query), out});
}

void encode_backward(const Query& query, const float* gradient, float* grad_table, float* grad_coordinates,
                     void* stream) {
    const device::Executor executor(stream);
    if (grad_table) executor.for_each(query.entries * query.features, device::Clear{grad_table});
    if (grad_coordinates) executor.for_each(3 * query.count, device::Clear{grad_coordinates});
    executor.for_each(query.count * query.level_count,
                      EncodeBackward{Grid(query), gradient, grad_table, grad_coordinates});
}

}  // namespace fourd::hashgrid::cuda
