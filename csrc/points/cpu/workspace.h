// The memory for rendering an image. The workspace is kept for the next image, because allocating a new workspace would
// take a fifth of the rendering time.
#pragma once

#include <vector>

#include "common/fingerprint.h"
#include "points/cpu/bins.h"
#include "tiles/run_tiles.h"

namespace fourd::points {

struct Workspace {
    // The memory of one worker (thread) for one tile.
    struct Scratch {
        Buffer<std::size_t> slots;
        Buffer<float> transmittance;
        Buffer<std::uint64_t> tags;
    };

    Fingerprint source_fingerprint;  // Hash of the inputs from which the current `bins` were computed.
    Bins bins;
    tiles::Slots slots;                      // Slots of the (point, tile) entries.
    Buffer<float> sums;                      // Indexed by slot.
    std::vector<Scratch> scratch_by_worker;  // Indexed by worker.

    // Projects, sorts and bins the points of a cloud.
    void fill(const Cloud& cloud, const Settings& settings, Team& team);

    // Calls draw(tile index) for all tiles, in parallel. Call bins.prepare() before this function. If the image has
    // more than kMaxEntries entries, bands of consecutive tile rows are binned and drawn one after another, to limit
    // the memory. Returns true if one band was enough, so that `bins` has the entries of the whole image.
    template <typename Draw>
    bool draw_tiles(Team& team, const Draw& draw);

    // Calls fill() unless `bins` were already computed from the same inputs. A backward pass usually has the same
    // inputs as the forward pass just before it.
    void fill_unless_current(const Cloud& cloud, const Settings& settings, Team& team);

    // Returns the inputs for rendering the tile with this index. Tiles are numbered row by row. Call fill() before this
    // function.
    Tile tile(const Cloud& cloud, const Settings& settings, int index) const;

    std::size_t bytes() const;  // Size of the memory that is kept between images.
};

constexpr std::size_t kMaxEntries = std::size_t{1} << 26;  // 256 MB, with 4 bytes per entry.

template <typename Draw>
bool Workspace::draw_tiles(Team& team, const Draw& draw) {
    int bands = 0;
    for (int top = 0; top < bins.rows(); ++bands) {
        const int bottom = bins.fill_band(top, kMaxEntries, team);
        tiles::run_tiles(team, top * bins.columns(), bottom * bins.columns(), [&](int index, int) { draw(index); });
        top = bottom;
    }
    return bands == 1;
}

}  // namespace fourd::points
