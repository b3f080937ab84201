#include "meshes/tile_slots.h"

#include <algorithm>
#include <cstring>

#include "common/inline.h"
#include "common/triangle_id.h"

namespace fourd::meshes {

int TileSlots::find(std::int32_t triangle) {
    unsigned bucket = static_cast<unsigned>(triangle) * 2654435761u >> 21;
    static_assert(kBuckets == 1 << 11, "the hash has 11 bits");
    while (buckets_[bucket] >= 0 && triangles_[buckets_[bucket]] != triangle) bucket = (bucket + 1) % kBuckets;
    if (buckets_[bucket] < 0) {
        buckets_[bucket] = static_cast<std::int16_t>(count_);
        triangles_[count_++] = triangle;
    }
    return buckets_[bucket];
}

void TileSlots::fill(const IdImage& image, int column, int row) {
    count_ = 0;
    std::memset(buckets_, 0xff, sizeof buckets_);
    std::memset(slot_of_, 0xff, sizeof slot_of_);
    const int columns = std::min(kTile, image.width - column), rows = std::min(kTile, image.height - row);
    const std::size_t stride = 4 * static_cast<std::size_t>(image.width);
    const std::size_t bytes = 4 * sizeof(float) * static_cast<std::size_t>(columns);
    for (int i = 0; i < rows; ++i) {
        const float* const ids = image.rast + static_cast<std::size_t>(row + i) * stride + 4 * column + 3;
        if (i + kRowsAhead < rows) prefetch_bytes(ids + kRowsAhead * stride, bytes);
        std::int16_t* const slots = slot_of_ + kTile * i;
        float last_id = 0.0f;
        std::int16_t last_slot = -1;
        for (int j = 0; j < columns; ++j) {
            const float id = ids[4 * j];
            if (!(id == last_id)) {
                const std::int32_t triangle = triangle_of_value(id);
                const bool is_valid = triangle >= 0 && static_cast<std::size_t>(triangle) < image.triangles;
                last_slot = is_valid ? static_cast<std::int16_t>(find(triangle)) : std::int16_t{-1};
                last_id = id;
            }
            slots[j] = last_slot;
        }
    }
}

void sum_by_vertex(const std::vector<TileValues>& tiles, const std::int32_t* tri, const VertexImage& image, float* out,
                   Team& team) {
    const std::size_t copies = image.is_shared ? 1 : static_cast<std::size_t>(image.images);
    const std::size_t rows = copies * image.vertices, channels = image.channels;
    const std::size_t tiles_per_image = image.images > 0 ? tiles.size() / image.images : 0;
    const std::size_t parts = static_cast<std::size_t>(team.size());
    team.run(team.size(), [&](int part, int) {
        const std::size_t begin = rows * part / parts, end = rows * (part + 1) / parts;
        std::fill(out + begin * channels, out + end * channels, 0.0f);
        for (std::size_t tile = 0; tile < tiles.size(); ++tile) {
            const std::size_t first = image.is_shared ? 0 : tile / tiles_per_image * image.vertices;
            if (first >= end || first + image.vertices <= begin) continue;
            const TileValues& from = tiles[tile];
            for (std::size_t slot = 0; slot < from.triangles.size(); ++slot) {
                const std::int32_t* const corners = tri + 3 * static_cast<std::size_t>(from.triangles[slot]);
                for (std::size_t k = 0; k < 3; ++k) {
                    const std::size_t vertex = static_cast<std::uint32_t>(corners[k]), at = first + vertex;
                    if (vertex >= image.vertices || at < begin || at >= end) continue;
                    const float* const values = from.values.data() + (3 * slot + k) * channels;
                    for (std::size_t c = 0; c < channels; ++c) out[at * channels + c] += values[c];
                }
            }
        }
    });
}

}  // namespace fourd::meshes
