// The memory that rendering an image uses. It is kept for the next image. If each image allocated new memory,
// allocation would take a fifth of the time.
#pragma once

#include <vector>

#include "common/fingerprint.h"
#include "points/cpu/bins.h"

namespace fourd::points {

struct Workspace {
    // The memory that a worker uses for one tile.
    struct Scratch {
        Buffer<std::size_t> slots;
        Buffer<float> transmittance;
        Buffer<std::uint64_t> tags;
    };

    Fingerprint source_fingerprint;  // of the inputs of the last render, if its bins are still here
    Bins bins;
    Buffer<std::size_t> slots;               // by point: its first slot
    Buffer<float> sums;                      // indexed by slot
    std::vector<Scratch> scratch_by_worker;  // indexed by worker

    // Projects and bins the points.
    void fill(const Cloud& cloud, const Settings& settings, Team& team);

    // Calls fill unless the last render had the same inputs. A backward pass usually finds the same inputs, because the
    // last render was its forward pass.
    void fill_unless_current(const Cloud& cloud, const Settings& settings, Team& team);

    // Gives each (point, tile) entry a slot, in which the tile writes its result for the point. Returns the number of
    // slots. The slots of a point are adjacent and are summed in a fixed order, so the sum does not depend on which
    // thread filled them. Call fill before, with a cloud of `count` points.
    std::size_t assign_slots(std::size_t count);

    // Writes the slots of the entries of a tile to out.
    void slots_of_tile(const Tile& tile, Buffer<std::size_t>& out) const;

    // The inputs for the tile with this index. Tiles are numbered row by row. Call fill before.
    Tile tile(const Cloud& cloud, const Settings& settings, int index) const;

    std::size_t bytes() const;  // size of the memory that is kept
};

}  // namespace fourd::points
