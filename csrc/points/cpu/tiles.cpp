// The inner loops over points and tiles, compiled once for each instruction set.
#include <cstring>
#if defined(__SSE2__) || defined(__AVX512F__)
#include <immintrin.h>
#endif

#include "common/inline.h"
#include "points/cpu/tiles.h"
#include "points/front_weight.h"
#include "points/octahedral.h"

namespace fourd::points::FOURD_SIMD {
namespace {

#include "tiles/lanes.h"

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "expected a little-endian processor, because two 16-bit values are written as one 32-bit word"
#endif

constexpr int kMaxChannels = 32;

// Projected points as a structure of arrays, which lets compilers vectorise the projection.
struct Projections {
    static constexpr std::size_t kMax = 64;
    float u[kMax], v[kMax], inverse_square[kMax], density[kMax], z[kMax], rho[kMax];
    // Ranges of blocks and of tiles along one axis. The lower 16 bits are the first index, and the upper 16 bits are
    // the last index.
    std::uint32_t blocks_across[kMax], blocks_down[kMax];
    std::uint32_t tiles_across[kMax], tiles_down[kMax];
    std::uint32_t visible[kMax];
};

inline std::uint32_t pair(int first, int last) {
    return static_cast<std::uint32_t>(first) | static_cast<std::uint32_t>(last) << 16;
}

// Projects `count` points, starting with point `begin`. Returns the number of visible points.
inline std::uint32_t project_some(const Cloud& cloud, const Settings& settings, std::size_t begin, std::size_t count,
                                  Projections& out) {
    constexpr int kBlocksPerSide = kTile / kBlock;
    // The compiler knows that writes through pointers do not change this local copy.
    const Pinhole camera = settings.camera;
    const float near_depth = settings.near_depth;
    std::uint32_t visible = 0;
    for (std::size_t i = 0; i < count; ++i) {
        const std::size_t point = begin + i;
        const Projection at =
            project(camera, near_depth, cloud.xyz + 3 * point, cloud.radius[point], cloud.density[point]);
        out.u[i] = at.u;
        out.v[i] = at.v;
        out.inverse_square[i] = at.inverse_square;
        out.density[i] = at.density;
        out.z[i] = at.z;
        out.rho[i] = at.rho;
        out.blocks_across[i] = pair(at.left, at.right);
        out.blocks_down[i] = pair(at.top, at.bottom);
        const std::uint32_t across = pair(at.left / kBlocksPerSide, at.right / kBlocksPerSide);
        const std::uint32_t down = pair(at.top / kBlocksPerSide, at.bottom / kBlocksPerSide);
        out.tiles_across[i] = at.visible ? across : pair(1, 0);
        out.tiles_down[i] = at.visible ? down : pair(0, 0);
        out.visible[i] = at.visible ? 1 : 0;
        visible += out.visible[i];
    }
    return visible;
}

// Returns the bits of a 32-bit value as an integer.
template <typename Number>
inline std::uint32_t word(const Number& number) {
    static_assert(sizeof number == sizeof(std::uint32_t), "one word");
    std::uint32_t out;
    std::memcpy(&out, &number, sizeof out);
    return out;
}

// Copies the projections, word by word, from arrays into splats. The splats of invisible points are written but never
// read.
inline void store_splats(const Projections& some, std::size_t count, Splat* splats) {
    std::uint32_t words[8 * Projections::kMax];
    static_assert(sizeof(Splat) == 32, "eight words, in the order of Splat's members");
    for (std::size_t i = 0; i < count; ++i) {
        words[8 * i] = word(some.u[i]);
        words[8 * i + 1] = word(some.v[i]);
        words[8 * i + 2] = word(some.inverse_square[i]);
        words[8 * i + 3] = word(some.density[i]);
        words[8 * i + 4] = word(some.z[i]);
        words[8 * i + 5] = word(some.rho[i]);
        words[8 * i + 6] = some.blocks_across[i];
        words[8 * i + 7] = some.blocks_down[i];
    }
    std::memcpy(splats, words, count * sizeof(Splat));
}

inline void store_tile_ranges(const Projections& some, std::size_t count, TileRange* tile_ranges) {
    std::uint32_t words[2 * Projections::kMax];
    static_assert(sizeof(TileRange) == 8, "two words, in the order of Reach's members");
    for (std::size_t i = 0; i < count; ++i) {
        words[2 * i] = some.tiles_across[i];
        words[2 * i + 1] = some.tiles_down[i];
    }
    std::memcpy(tile_ranges, words, count * sizeof(TileRange));
}

std::size_t project_run(const Cloud& cloud, const Settings& settings, std::size_t begin, std::size_t end, Splat* splats,
                        TileRange* tile_ranges, Item* items) {
    Projections some;
    std::size_t count = 0;
    for (std::size_t first = begin; first < end; first += Projections::kMax) {
        const std::size_t here = end - first < Projections::kMax ? end - first : Projections::kMax;
        const std::uint32_t visible = project_some(cloud, settings, first, here, some);
        store_tile_ranges(some, here, tile_ranges + first);
        if (visible == 0) continue;
        store_splats(some, here, splats + first);
        for (std::size_t i = 0; i < here; ++i) {
            // To avoid branches, the loop writes an item for every point, but increases `count` only if the point is
            // visible. `count` never exceeds first + i - begin, so the write stays inside `items`.
            items[count] = {word(some.z[i]), static_cast<std::uint32_t>(first + i)};
            count += some.visible[i];
        }
    }
    return count;
}

#include "tiles/grid.inc"
#include "points/cpu/coverage.inc"
#include "tiles/traversal.inc"
#include "tiles/pixels.inc"
#include "points/cpu/picture.inc"
#include "points/cpu/surface.inc"
#include "points/cpu/gradient.inc"

struct MaxWeight {
    static constexpr bool kCountsVisits = false;
    const std::size_t* slots;
    float* weights;

    void take(const Chunk& chunk, int position, int, const Coverage& coverage, Mask hit, Lanes transmittance) {
        if (!any(hit)) return;
        float& weight = weights[slots[chunk.first + position]];
        const float here = max_lane(keep(hit, transmittance * coverage.alpha));
        weight = here > weight ? here : weight;
    }
};

void tile_visibility(const Tile& tile, const std::size_t* slots, float* weights) {
    const Grid grid = pixel_grid(tile);
    PixelState state = initial_state(tile, grid);
    MaxWeight found[kBlocks];
    for (MaxWeight& block : found) block = {slots, weights};
    traverse(tile, grid, tile.transmittance_min, state, found);
}

}  // namespace

const Loops loops = {project_run, render_tile, draw_tile, join_normals, draw_tile_surface, render_tile_backward, tile_visibility};

}  // namespace fourd::points::FOURD_SIMD
