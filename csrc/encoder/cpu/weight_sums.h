// The gradient of the encoder's weights, summed over all positions of all images in a fixed order.
#pragma once

#include <cstddef>
#include <vector>

#include "common/team.h"
#include "encoder/cpu/loops.h"
#include "encoder/cpu/weights.h"
#include "encoder/maps.h"

namespace fourd::encoder {

// The input of a layer in one image, and the gradient of the layer's output.
struct LayerMaps {
    Map in, gradient;
};

class WeightSums {
  public:
    WeightSums(const Sizes& sizes, const Layers& layers);

    // Adds the sums over some images. `maps` has the maps of all layers of the first image, then those of the next.
    void add(const std::vector<LayerMaps>& maps, const Loops& loops, Team& team);

    // Writes the gradients in torch's shapes.
    void write(const Layers& layers, float* const* out) const;

  private:
    // The sums of one layer, for kTile output channels at a time: shape (tiles, taps + 1, kTile). The last row has the
    // sums of the bias.
    struct Totals {
        std::vector<std::ptrdiff_t> offsets;
        int tiles;
        std::vector<float> sums;

        std::size_t tile_size() const { return (offsets.size() + 1) * kTile; }
    };

    // Part of the positions of one image, for one tile of a layer.
    struct Task {
        int layer, tile, image, from, to;
        std::size_t place;  // Of the part's sums.
    };

    std::vector<Task> tasks_of(const std::vector<LayerMaps>& maps) const;

    std::vector<Totals> totals_;
};

}  // namespace fourd::encoder
