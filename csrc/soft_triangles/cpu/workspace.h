// The memory for rendering an image, which is kept for the next image.
#pragma once

#include <vector>

#include "soft_triangles/cpu/tiles.h"
#include "tiles/depth_bins.h"

namespace fourd::soft_triangles {

struct Workspace {
    // The memory that one worker (thread) uses for one tile.
    struct Scratch {
        Buffer<std::size_t> slots;
        Buffer<std::uint16_t> blocks;
        Buffer<std::uint32_t> entries;
        Buffer<float> x, depth;

        // Allocates the arrays of Visits (tiles.h) for one tile, and returns pointers to them.
        Visits visits(const Tile& tile);
    };

    tiles::DepthBins bins;
    tiles::Slots slots;
    Buffer<Face> faces;                      // Indexed by triangle. Only visible triangles have a valid face.
    Buffer<float> sums;                      // Gradient sums, one row per slot. A slot is a (triangle, tile) pair.
    Buffer<float> corners;                   // Gradients of the positions of the 3 vertices of each triangle.
    std::vector<Scratch> scratch_by_worker;  // Indexed by worker.

    // Projects and bins the triangles of a mesh.
    void fill(const Mesh& mesh, const Settings& settings, Team& team);

    // Returns the inputs for rendering the tile with this index. Tiles are numbered row by row.
    Tile tile(const Mesh& mesh, const Settings& settings, int index) const;

    std::size_t bytes() const;  // Size of the memory that is kept between images.
};

}  // namespace fourd::soft_triangles
