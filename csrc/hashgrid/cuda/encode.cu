#include "hashgrid/cuda/encode.h"

#include "device/clear.h"
#include "device/machine.h"

namespace fourd::hashgrid::cuda {
namespace {

// Kernels over a query's levels and points, level by level, so that what runs together shares one level's entries in
// the cache (the paper's sec. 4).
struct Grid {
    Level levels[kMostLevels];
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

struct Place {
    const Level& level;
    std::size_t row;  // of the encoding: where this level's features of the point begin
    const float* coordinates;
    std::size_t point;
    Cell cell;

    FOURD_DEVICE Place(const Grid& grid, std::size_t index) : level(grid.levels[index / grid.count]) {
        point = index % grid.count;
        row = (point * grid.level_count + index / grid.count) * grid.features;
        coordinates = grid.coordinates + 3 * point;
        cell = cell_of(level, between(level, coordinates[0]), between(level, coordinates[1]),
                       between(level, coordinates[2]));
    }

    // Of a corner's entry in the table.
    FOURD_DEVICE std::size_t at(const Grid& grid, int corner) const {
        return (level.first + cell.entry[corner]) * grid.features;
    }

    FOURD_DEVICE float weight(int corner) const {
        return cell.weight[corner / 2] * (corner % 2 ? cell.share : 1.0f - cell.share);
    }
};

struct Encode {
    Grid grid;
    float* out;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Place place(grid, index);
        // Sums feature by feature: an array of them, indexed by a number that is not known here, would be in memory.
        for (int f = 0; f < grid.features; ++f) {
            float sum = 0.0f;
            for (int corner = 0; corner < kCorners; ++corner) {
                sum += place.weight(corner) * grid.table[place.at(grid, corner) + f];
            }
            out[place.row + f] = sum;
        }
    }
};

struct EncodeBackward {
    Grid grid;
    const float* gradient;
    float* to_table;        // or null
    float* to_coordinates;  // or null

    FOURD_DEVICE void operator()(std::size_t index) const {
        const Place place(grid, index);
        const float* from = gradient + place.row;
        float along[kCorners];  // the gradient's part in each corner's entry
        for (int corner = 0; corner < kCorners; ++corner) {
            const std::size_t at = place.at(grid, corner);
            along[corner] = 0.0f;
            for (int f = 0; f < grid.features; ++f) {
                if (to_table) device::add_shared(to_table + at + f, place.weight(corner) * from[f]);
                if (to_coordinates) along[corner] += from[f] * grid.table[at + f];
            }
        }
        if (!to_coordinates) return;
        float slopes[3] = {};
        add_slopes(place.level, place.coordinates, along, slopes);
        for (int axis = 0; axis < 3; ++axis) device::add_shared(to_coordinates + 3 * place.point + axis, slopes[axis]);
    }
};

}  // namespace

void encode(const Query& query, float* out, void* stream) {
    device::Machine(stream).each(query.count * query.level_count, Encode{Grid(query), out});
}

void encode_backward(const Query& query, const float* gradient, float* grad_table, float* grad_coordinates,
                     void* stream) {
    const device::Machine machine(stream);
    if (grad_table) machine.each(query.entries * query.features, device::Clear{grad_table});
    if (grad_coordinates) machine.each(3 * query.count, device::Clear{grad_coordinates});
    machine.each(query.count * query.level_count, EncodeBackward{Grid(query), gradient, grad_table, grad_coordinates});
}

}  // namespace fourd::hashgrid::cuda
