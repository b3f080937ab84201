// What a picture is made from; kept, its memory serves the next one.
#pragma once

#include "points/cpu/bins.h"

namespace fourd::points {

struct Workspace {
    Bins bins;
    Buffer<float> features;  // by rank

    void fill(const Cloud& cloud, const Settings& settings, Team& team);

    // Lays the features of visible points side by side in their order. After fill.
    void rank_features(const Cloud& cloud, Team& team);

    // What tile index (row by row) is made of.
    Tile tile(const Settings& settings, int channels, int index) const;
};

}  // namespace fourd::points
