#include "encoder/cpu/weight_sums.h"

#include <algorithm>

namespace fourd::encoder {
namespace {

constexpr std::size_t kLeastPositions = 1024;  // Of a task. Few positions would make the sums over lanes expensive.

bool has_stride(int layer) { return layer == kHalfFirst / 2 || layer == kQuarterFirst / 2; }

}  // namespace

WeightSums::WeightSums(const Sizes& sizes, const Layers& layers) {
    const Levels at = levels_of(sizes);
    const Level* levels[kLayers] = {&at.full,    &at.full, &at.half, &at.half,    &at.quarter,
                                    &at.quarter, &at.half, &at.full, &at.quarter, &at.full};
    for (int layer = 0; layer < kLayers; ++layer) {
        const Shape& shape = layers[2 * layer].shape;
        Totals totals{tap_offsets(shape, *levels[layer], has_stride(layer) ? 2 : 1), padded(shape.outputs) / kTile, {}};
        totals.sums.assign(totals.tiles * totals.tile_size(), 0.0f);
        totals_.push_back(std::move(totals));
    }
}

std::vector<WeightSums::Task> WeightSums::tasks_of(const std::vector<LayerMaps>& maps) const {
    std::vector<Task> out;
    std::size_t place = 0;
    for (std::size_t i = 0; i < maps.size(); ++i) {
        const int layer = static_cast<int>(i % kLayers), image = static_cast<int>(i / kLayers);
        const Level& level = maps[i].gradient.level;
        const int rows = static_cast<int>((kLeastPositions + level.pitch() - 1) / level.pitch());
        for (int tile = 0; tile < totals_[layer].tiles; ++tile) {
            for (int from = 0; from < level.height; from += rows) {
                out.push_back({layer, tile, image, from, std::min(from + rows, level.height), place});
                place += totals_[layer].tile_size();
            }
        }
    }
    return out;
}

void WeightSums::add(const std::vector<LayerMaps>& maps, const Loops& loops, Team& team) {
    const std::vector<Task> tasks = tasks_of(maps);
    const std::size_t size = tasks.empty() ? 0 : tasks.back().place + totals_[tasks.back().layer].tile_size();
    std::vector<float> sums(size, 0.0f);
    team.run(static_cast<int>(tasks.size()), [&](int number, int) {
        const Task& task = tasks[number];
        const Totals& totals = totals_[task.layer];
        const LayerMaps& at = maps[static_cast<std::size_t>(task.image) * kLayers + task.layer];
        const Level& level = at.gradient.level;
        const int taps = static_cast<int>(totals.offsets.size());
        float* out = sums.data() + task.place;
        loops.correlate({at.gradient.row(task.tile * kTile, task.from), level.plane(),
                         at.in.data + level.row(task.from), totals.offsets.data(), taps, out,
                         out + static_cast<std::size_t>(taps) * kTile},
                        level.span(task.from, task.to));
    });
    for (const Task& task : tasks) {
        Totals& totals = totals_[task.layer];
        float* to = totals.sums.data() + task.tile * totals.tile_size();
        const float* from = sums.data() + task.place;
        for (std::size_t i = 0; i < totals.tile_size(); ++i) to[i] += from[i];
    }
}

void WeightSums::write(const Layers& layers, float* const* out) const {
    std::vector<float> combined(kMerged * kHalf), combined_bias(kMerged);
    for (int layer = 0; layer < kLayers; ++layer) {
        const Shape& shape = layers[2 * layer].shape;
        const Totals& totals = totals_[layer];
        const bool is_combined = layer == kLateralHalf / 2;
        float* weights = is_combined ? combined.data() : out[2 * layer];
        float* bias = is_combined ? combined_bias.data() : out[2 * layer + 1];
        const std::size_t taps = totals.offsets.size();
        for (int o = 0; o < shape.outputs; ++o) {
            const float* from = totals.sums.data() + o / kTile * totals.tile_size() + o % kTile;
            for (std::size_t tap = 0; tap < taps; ++tap) weights[o * taps + tap] = from[tap * kTile];
            bias[o] = from[taps * kTile];
        }
    }
    layers.split_combined(combined.data(), combined_bias.data(), out);
}

}  // namespace fourd::encoder
