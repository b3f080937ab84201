// What a picture is made from. Kept, its memory serves the next one: fresh memory would cost a fifth of the time.
#pragma once

#include <vector>

#include "common/fingerprint.h"
#include "points/cpu/bins.h"

namespace fourd::points {

struct Workspace {
    // What a worker needs for its tile.
    struct Scratch {
        Buffer<std::size_t> slots;
        Buffer<float> transmittance;
        Buffer<std::uint64_t> tags;
    };

    Fingerprint made_from;  // of the cloud and settings of the last render, where nothing came after it
    Bins bins;
    Buffer<std::size_t> slots;        // by point: where its slots begin
    Buffer<float> sums;               // by slot
    std::vector<Scratch> scratches;   // by worker

    // Projects and bins the points.
    void fill(const Cloud& cloud, const Settings& settings, Team& team);

    // The same, unless it was done for a render just before: a gradient mostly follows its picture.
    void fill_again(const Cloud& cloud, const Settings& settings, Team& team);

    // Gives each entry of the bins a slot for what its tile finds out about its point, and returns how many
    // there are. A point's slots lie side by side, so that they are merged in one order whatever thread
    // filled them. After fill, of a cloud of count points.
    std::size_t assign_slots(std::size_t count);

    // The slots of a tile's entries.
    void slots_of_tile(const Tile& tile, Buffer<std::size_t>& out) const;

    // What tile index (row by row) is made of. After fill.
    Tile tile(const Cloud& cloud, const Settings& settings, int index) const;

    std::size_t bytes() const;  // of memory that is kept
};

}  // namespace fourd::points
