// Cuts the triangles of images into pieces (whole triangles or parts of clipped triangles), and bins the pieces into
// tiles.
#pragma once

#include <vector>

#include "common/buffer.h"
#include "common/team.h"
#include "rasterize/cpu/loops.h"
#include "rasterize/rasterize.h"

namespace fourd::rasterize {

// The pieces of a group of consecutive images, binned into tiles. Tiles are numbered image by image and row by row.
class Bins {
  public:
    // Returns the number of images per group, which is at least one. Smaller groups need less memory, because the
    // memory of a group is proportional to its number of triangles.
    static int group_size(const Query& query);

    // Bins the pieces of the images [first, last), and replaces the previous contents.
    void fill(const Query& query, int first, int last, Team& team);

    int tiles() const { return tiles_per_image_ * images_; }
    int tiles_per_image() const { return tiles_per_image_; }
    int columns() const { return columns_; }

    // The pieces of a tile, in ascending order of their triangle indices.
    const Piece* pieces(int tile) const { return pieces_.data() + begin_[tile]; }
    std::size_t count(int tile) const { return begin_[tile + 1] - begin_[tile]; }

  private:
    struct Entry {
        Piece piece;
        Bounds bounds;
        int image;
    };

    void snap_vertices(const Query& query, int first, Team& team);
    void cut(const Query& query, int first, std::size_t begin, std::size_t end, int part);

    int images_ = 0, columns_ = 0, tiles_per_image_ = 0;
    // Number of sets of vertex positions: one for each image of the group, or a single one if all images share the
    // positions.
    std::size_t vertex_images_ = 0;
    Buffer<Snapped> vertices_;
    // An item is one triangle of one image. first_item_ has the index of each image's first item.
    std::vector<std::size_t> first_item_;
    // The items are divided into parts, one per worker. For each part, entries_ has the pieces of the part's
    // triangles, and counts_ has the number of these pieces in every tile.
    std::vector<std::vector<Entry>> entries_;
    std::vector<std::vector<std::uint32_t>> counts_;
    Buffer<Piece> pieces_;
    // For each tile, the index in pieces_ of its first piece. The last element is the sum of the tiles' piece counts.
    std::vector<std::size_t> begin_;
};

}  // namespace fourd::rasterize
