#include "play/play.h"

#include <algorithm>

#include "common/half.h"
#include "common/team.h"
#include "play/near_fade.h"

namespace fourd::play {
namespace {

constexpr std::size_t kPointsPerTask = 8192;

}  // namespace

void Sizes::require(std::size_t count) {
    radius.require(count);
    density.require(count);
}

void Sizes::convert(const Frame& frame, std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) radius[i] = from_half(frame.radius[i]);
    for (std::size_t i = begin; i < end; ++i) density[i] = from_half(frame.density[i]);
}

void Sizes::fade(const Frame& frame, const points::Settings& settings, std::size_t begin, std::size_t end) {
    // The compiler knows that writes through pointers do not change this local copy.
    const points::Pinhole camera = settings.camera;
    const float near_depth = settings.near_depth;
    for (std::size_t i = begin; i < end; ++i)
        density[i] = faded_density(camera, near_depth, frame.points.xyz + 3 * i, density[i]);
}

void EmptyTiles::start(const points::Surface& surface, int width, int height, std::size_t tiles) {
    const points::Surface& old = surface_;
    const bool is_same = surface.canvas.rgba == old.canvas.rgba && surface.inverse_depth == old.inverse_depth &&
                         surface.normal == old.normal && width == width_ && height == height_;
    is_kept_ = is_same && surface.persistence > 0.0f &&
               std::equal(surface.canvas.background, surface.canvas.background + 3, old.canvas.background);
    if (!is_kept_) empty_.assign(tiles, 0);
    surface_ = surface;
    width_ = width;
    height_ = height;
}

bool EmptyTiles::is_drawn(int tile, bool is_empty) {
    std::uint8_t& before = empty_[static_cast<std::size_t>(tile)];
    const bool is_drawn = is_kept_ && is_empty && before != 0;
    before = is_empty ? 1 : 0;
    return is_drawn;
}

template <typename Work>
points::Cloud Player::prepare(const Frame& frame, const points::Settings& settings, const shade::Settings& shading,
                              Team& team, const Work& work) {
    const std::size_t count = frame.points.count;
    sizes_.require(count);
    colour_.require(3 * count);
    run_parts(team, count, kPointsPerTask, [&](std::size_t begin, std::size_t end) {
        sizes_.convert(frame, begin, end);
        sizes_.fade(frame, settings, begin, end);
    });
    const points::Cloud cloud{frame.points.xyz, colour_.data(), sizes_.radius.data(), sizes_.density.data(), count, 3};
    workspace_.source_fingerprint = Fingerprint();
    workspace_.bins.prepare(cloud, settings, team);
    run_parts(team, count, kPointsPerTask, [&](std::size_t begin, std::size_t end) {
        for_visible(begin, end, [&](std::size_t first, std::size_t last) {
            shade::shade_some(frame.points, shading, first, last, colour_.data());
            work(first, last);
        });
    });
    return cloud;
}

void Player::draw(const Frame& frame, const points::Settings& settings, const shade::Settings& shading,
                  const points::Canvas& canvas, float filter_side) {
    Team team(settings.threads);
    const points::Cloud cloud = prepare(frame, settings, shading, team, [](std::size_t, std::size_t) {});
    const points::Loops& loops = points::select_loops(settings.simd);
    const bool is_one_band = workspace_.draw_tiles(
        team, [&](int index) { loops.draw(workspace_.tile(cloud, settings, index), canvas); });
    if (filter_side == 0.0f) return;
    const int width = settings.camera.width, height = settings.camera.height;
    // If the image was drawn in several bands, the bins have the entries of the last band only. filtered_region() would
    // then miss tiles, so the whole image is filtered.
    const pixel_filter::Region region =
        is_one_band ? filtered_region(width, height) : pixel_filter::Region{0, 0, width, height};
    pixel_filter::filter_in_place(canvas.rgba, width, height, region, filter_side, settings.simd, team,
                                  filter_scratch_);
}

pixel_filter::Region Player::filtered_region(int width, int height) const {
    const int columns = workspace_.bins.columns();
    pixel_filter::Region tiles{columns, workspace_.bins.rows(), 0, 0};
    for (int index = 0; index < workspace_.bins.tiles(); ++index) {
        if (workspace_.bins.tile_begin()[index] == workspace_.bins.tile_begin()[index + 1]) continue;
        const int column = index % columns, row = index / columns;
        tiles = {std::min(tiles.left, column), std::min(tiles.top, row), std::max(tiles.right, column + 1),
                 std::max(tiles.bottom, row + 1)};
    }
    // The filter also changes the pixels next to a tile with points.
    return {std::max(tiles.left * tiles::kTile - 1, 0), std::max(tiles.top * tiles::kTile - 1, 0),
            std::min(tiles.right * tiles::kTile + 1, width), std::min(tiles.bottom * tiles::kTile + 1, height)};
}

void Player::draw_surface(const Frame& frame, const points::Settings& settings, const shade::Settings& shading,
                          const points::Surface& surface) {
    Team team(settings.threads);
    surface_features_.require(points::kSurfaceFeatures * frame.points.count);
    const points::Loops& loops = points::select_loops(settings.simd);
    // join_normals() runs right after shading, while the positions and colours of the points are still in the cache.
    points::Cloud cloud = prepare(frame, settings, shading, team, [&](std::size_t first, std::size_t last) {
        loops.join_normals(settings.camera, frame.points.xyz, colour_.data(), frame.normals, first, last,
                           surface_features_.data());
    });
    cloud.features = surface_features_.data();
    cloud.channels = points::kSurfaceFeatures;
    const points::Bins& bins = workspace_.bins;
    empty_tiles_.start(surface, settings.camera.width, settings.camera.height,
                       static_cast<std::size_t>(bins.columns()) * static_cast<std::size_t>(bins.rows()));
    workspace_.draw_tiles(team, [&](int index) {
        const points::Tile tile = workspace_.tile(cloud, settings, index);
        if (!empty_tiles_.is_drawn(index, tile.count == 0)) loops.draw_surface(tile, surface);
    });
}

// The points of a frame are in spatial order, so invisible points form long spans, which the function skips.
template <typename Work>
void Player::for_visible(std::size_t begin, std::size_t end, const Work& work) const {
    constexpr std::size_t kRange = points::kJoinedPoints;
    for (std::size_t first = begin; first < end; first += kRange) {
        const std::size_t last = std::min(end, first + kRange);
        std::size_t tiles = 0;
        for (std::size_t i = first; i < last; ++i) tiles += points::tile_count(workspace_.bins.tile_range(i));
        if (tiles > 0) work(first, last);
    }
}

std::size_t DepthSorter::sort(const Frame& frame, const points::Settings& settings, std::uint32_t* out) {
    const std::size_t count = frame.points.count;
    sizes_.require(count);
    Team team(settings.threads);
    run_parts(team, count, kPointsPerTask,
              [&](std::size_t begin, std::size_t end) { sizes_.convert(frame, begin, end); });
    const points::Cloud cloud{frame.points.xyz, nullptr, sizes_.radius.data(), sizes_.density.data(), count, 0};
    bins_.sort_points(cloud, settings, team);
    run_parts(team, bins_.visible(), kPointsPerTask, [&](std::size_t begin, std::size_t end) {
        for (std::size_t rank = begin; rank < end; ++rank) out[rank] = bins_.order()[rank].index;
    });
    return bins_.visible();
}

}  // namespace fourd::play
