// Helps the backward passes of several operators to compute a gradient for each vertex of a mesh. First, the triangles
// that are visible in a tile of the image get indices (slots), and each tile sums the gradients of its pixels for the
// three vertices of each of these triangles. Then these values are summed over the tiles. The order of the additions is
// fixed, so the sums do not depend on the number of threads.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/buffer.h"
#include "common/team.h"

namespace fourd::meshes {

constexpr int kTile = 32;  // Side of a tile in pixels.
constexpr int kTilePixels = kTile * kTile;
// While a row of a tile is read, the row kRowsAhead rows below is prefetched, because the rows are so far apart in
// memory that the processor does not prefetch them by itself.
constexpr int kRowsAhead = 4;

// An image whose fourth channel has encoded triangle ids (common/triangle_id.h).
struct IdImage {
    const float* rast;  // Shape (height, width, 4).
    int width, height;
    std::size_t triangles;  // Number of triangles. Ids beyond this number count as background.

    int columns() const { return (width + kTile - 1) / kTile; }
    int tiles() const { return columns() * ((height + kTile - 1) / kTile); }
};

// The visible triangles of one tile. The slot of a triangle is its index in the order in which the triangles first
// appear in the tile, row by row.
class TileSlots {
  public:
    void fill(const IdImage& image, int column, int row);

    int count() const { return count_; }
    const std::int32_t* triangles() const { return triangles_; }  // Indexed by slot.
    const std::int16_t* slot_of() const { return slot_of_; }      // Shape (kTile, kTile): slot, or -1 for no triangle.

  private:
    static constexpr int kBuckets = 2 * kTilePixels;

    int find(std::int32_t triangle);

    int count_ = 0;
    std::int32_t triangles_[kTilePixels];
    std::int16_t slot_of_[kTilePixels];
    std::int16_t buckets_[kBuckets];
};

// The values that one tile adds to the vertices of its visible triangles.
struct TileValues {
    std::vector<std::int32_t> triangles;
    Buffer<float> values;  // Shape (slots, 3, channels): values of the three vertices.
};

struct VertexImage {
    std::size_t vertices;
    std::size_t channels;
    int images;
    bool is_shared;  // Whether all images add to the same vertices.
};

// Overwrites `out` (images or 1, vertices, channels) with the sums of the values over all tiles. Tiles are numbered
// image by image. `tri` (triangles, 3) has the vertex indices of the triangles. Vertex indices out of range are
// skipped.
void sum_by_vertex(const std::vector<TileValues>& tiles, const std::int32_t* tri, const VertexImage& image, float* out,
                   Team& team);

}  // namespace fourd::meshes
