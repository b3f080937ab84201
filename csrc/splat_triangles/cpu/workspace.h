// The memory for rendering an image, which is kept for the next image.
#pragma once

#include <vector>

#include "common/fingerprint.h"
#include "splat_triangles/cpu/tiles.h"
#include "tiles/depth_bins.h"

namespace fourd::splat_triangles {

struct Workspace {
    // The memory that one worker (thread) uses for one tile.
    struct Scratch {
        Buffer<std::size_t> slots;
        Buffer<float> best;
    };

    Fingerprint source_fingerprint;  // Hash of the inputs from which the current `bins` were computed.
    tiles::DepthBins bins;
    tiles::Slots slots;
    Buffer<Splat> splats;                    // Indexed by triangle. Only visible triangles have a valid splat.
    Buffer<float> sums;                      // Gradient sums, one row per slot. A slot is a (triangle, tile) pair.
    Buffer<float> corners;                   // Gradients of the positions of the 3 vertices of each triangle.
    std::vector<Scratch> scratch_by_worker;  // Indexed by worker.

    // Projects, sorts and bins the triangles of a mesh, unless `bins` were already computed from the same inputs. A
    // backward pass usually has the same inputs as the forward pass just before it.
    void fill(const Mesh& mesh, const Settings& settings, Team& team);

    // Returns the inputs for rendering the tile with this index. Tiles are numbered row by row.
    Tile tile(const Mesh& mesh, const Settings& settings, int index) const;

    std::size_t bytes() const;  // Size of the memory that is kept between images.
};

}  // namespace fourd::splat_triangles
