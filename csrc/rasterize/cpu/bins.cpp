#include "rasterize/cpu/bins.h"

#include <algorithm>

#include "rasterize/clipping.h"

namespace fourd::rasterize {
namespace {

constexpr std::size_t kItemsPerGroup = std::size_t{1} << 22;

struct Range {
    std::size_t first, count;
};

// Returns the range of triangles that an image shows, clipped to the triangles that exist.
Range triangle_range(const Query& query, int image) {
    if (query.ranges == nullptr) return {0, query.triangles};
    const std::size_t first = static_cast<std::size_t>(std::max(query.ranges[2 * image], 0));
    const std::size_t count = static_cast<std::size_t>(std::max(query.ranges[2 * image + 1], 0));
    if (first >= query.triangles) return {0, 0};
    return {first, std::min(count, query.triangles - first)};
}

template <typename Visit>
void for_tiles(const Bounds& bounds, int columns, const Visit& visit) {
    for (int row = bounds.top / kTile; row <= bounds.bottom / kTile; ++row) {
        for (int column = bounds.left / kTile; column <= bounds.right / kTile; ++column) visit(row * columns + column);
    }
}

}  // namespace

int Bins::group_size(const Query& query) {
    const std::size_t per_image = std::max<std::size_t>({query.triangles, query.pixels() / 4, query.vertices, 1});
    const std::size_t size = std::max<std::size_t>(kItemsPerGroup / per_image, 1);
    return static_cast<int>(std::min(size, static_cast<std::size_t>(std::max(query.images, 1))));
}

void Bins::snap_vertices(const Query& query, int first, Team& team) {
    constexpr std::size_t kChunk = 8192;
    vertex_images_ = query.image_stride == 0 ? 1 : static_cast<std::size_t>(images_);
    const Screen screen = make_screen(query.width, query.height);
    vertices_.require(query.vertices * vertex_images_);
    const std::size_t chunks = (query.vertices + kChunk - 1) / kChunk;
    team.run(static_cast<int>(chunks * vertex_images_), [&](int task, int) {
        const std::size_t image = task / chunks, begin = task % chunks * kChunk;
        const std::size_t end = std::min(query.vertices, begin + kChunk);
        const float* const pos = query.pos_of(first + image);
        Snapped* const out = vertices_.data() + image * query.vertices;
        for (std::size_t i = begin; i < end; ++i) out[i] = snap(screen, pos + 4 * i);
    });
}

// Cuts the items [begin, end) into pieces. An item is a triangle of an image.
void Bins::cut(const Query& query, int first, std::size_t begin, std::size_t end, int part) {
    const Screen screen = make_screen(query.width, query.height);
    std::vector<Entry>& entries = entries_[part];
    std::vector<std::uint32_t>& counts = counts_[part];
    entries.clear();
    entries.reserve(end - begin);
    counts.assign(static_cast<std::size_t>(tiles()), 0);
    int image = static_cast<int>(std::upper_bound(first_item_.begin(), first_item_.end(), begin) -
                                 first_item_.begin()) - 1;
    for (std::size_t item = begin; item < end;) {
        while (first_item_[image + 1] <= item) ++image;
        const std::size_t stop = std::min(end, first_item_[image + 1]);
        const std::size_t offset = triangle_range(query, first + image).first - first_item_[image];
        const Snapped* const vertices = vertices_.data() + (vertex_images_ == 1 ? 0 : image * query.vertices);
        const float* const pos = query.pos_of(static_cast<std::size_t>(first + image));
        std::uint32_t* const tile_counts = counts.data() + static_cast<std::size_t>(image) * tiles_per_image_;
        for (; item < stop; ++item) {
            const std::size_t triangle = offset + item;
            const std::size_t a = static_cast<std::uint32_t>(query.tri[3 * triangle]);
            const std::size_t b = static_cast<std::uint32_t>(query.tri[3 * triangle + 1]);
            const std::size_t c = static_cast<std::uint32_t>(query.tri[3 * triangle + 2]);
            // As an unsigned integer, a negative index is larger than every valid index.
            if (std::max({a, b, c}) >= query.vertices) continue;
            for_pieces(screen, vertices[a], vertices[b], vertices[c], pos + 4 * a, pos + 4 * b, pos + 4 * c,
                       static_cast<int>(triangle), [&](const Piece& piece, const Bounds& bounds) {
                           entries.push_back({piece, bounds, image});
                           for_tiles(bounds, columns_, [&](int tile) { ++tile_counts[tile]; });
                       });
        }
    }
}

void Bins::fill(const Query& query, int first, int last, Team& team) {
    images_ = last - first;
    columns_ = (query.width + kTile - 1) / kTile;
    tiles_per_image_ = columns_ * ((query.height + kTile - 1) / kTile);
    snap_vertices(query, first, team);
    first_item_.assign(1, 0);
    for (int image = first; image < last; ++image) {
        first_item_.push_back(first_item_.back() + triangle_range(query, image).count);
    }
    // The items are divided into parts of consecutive items, one part per worker. Each worker cuts the triangles of its
    // part into pieces and bins them into tiles. The pieces are merged in the order of the parts, so the result does
    // not depend on the number of parts.
    const int parts = team.size();
    const std::size_t items = first_item_.back();
    entries_.resize(parts);
    counts_.resize(parts);
    team.run(parts, [&](int part, int) {
        cut(query, first, items * part / parts, items * (part + 1) / parts, part);
    });
    begin_.resize(static_cast<std::size_t>(tiles()) + 1);
    std::size_t total = 0;
    for (int tile = 0; tile < tiles(); ++tile) {
        begin_[tile] = total;
        for (int part = 0; part < parts; ++part) total += counts_[part][tile];
    }
    begin_[tiles()] = total;
    pieces_.require(total);
    std::vector<std::vector<std::size_t>> places(parts);
    for (int part = 0; part < parts; ++part) {
        places[part].resize(tiles());
        for (int tile = 0; tile < tiles(); ++tile) {
            places[part][tile] = part == 0 ? begin_[tile] : places[part - 1][tile] + counts_[part - 1][tile];
        }
    }
    team.run(parts, [&](int part, int) {
        for (const Entry& entry : entries_[part]) {
            std::size_t* const place = places[part].data() + static_cast<std::size_t>(entry.image) * tiles_per_image_;
            for_tiles(entry.bounds, columns_, [&](int tile) { pieces_[place[tile]++] = entry.piece; });
        }
    });
}

}  // namespace fourd::rasterize
