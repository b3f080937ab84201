#include "play/play.h"

#include <algorithm>

#include "common/half.h"
#include "common/team.h"

namespace fourd::play {
namespace {

constexpr std::size_t kPointsPerTask = 8192;

}  // namespace

void Player::draw(const Frame& frame, const points::Settings& settings, const shade::Settings& shading,
                  const points::Canvas& canvas) {
    const std::size_t count = frame.points.count;
    radius_.require(count);
    density_.require(count);
    colour_.require(3 * count);
    Team team(settings.threads);
    team.run(static_cast<int>((count + kPointsPerTask - 1) / kPointsPerTask), [&](int task, int) {
        const std::size_t begin = task * kPointsPerTask, end = std::min(count, begin + kPointsPerTask);
        for (std::size_t i = begin; i < end; ++i) radius_[i] = from_half(frame.radius[i]);
        for (std::size_t i = begin; i < end; ++i) density_[i] = from_half(frame.density[i]);
        shade::shade_some(frame.points, shading, begin, end, colour_.data());
    });
    const points::Cloud cloud{frame.points.xyz, colour_.data(), radius_.data(), density_.data(), count, 3};
    space_.fill(cloud, settings, team);
    const points::TileKernels& kernels = points::tile_kernels(settings.simd);
    team.run(space_.bins.tiles(), [&](int index, int) { kernels.draw(space_.tile(settings, 3, index), canvas); });
}

}  // namespace fourd::play
