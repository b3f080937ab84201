#include <vector>

#include "common/buffer.h"
#include "encoder/cpu/bands.h"
#include "encoder/cpu/weight_sums.h"
#include "encoder/encoder.h"

namespace fourd::encoder {
namespace {

struct Image {
    const float* grad_features;
    SavedMaps maps;
    GradientMaps gradients;
};

// The four lists of taps of a convolution with stride 2, for even and odd rows and columns.
struct PhaseTaps {
    TapList lists[4];

    PhaseTaps(const Layer& layer, const Level& level) {
        for (int phase = 0; phase < 4; ++phase) {
            lists[phase] = backward_phase_taps(layer, level, phase / 2 == 1, phase % 2 == 1);
        }
    }
};

struct Network {
    TapList full, half, quarter, combined, lateral, reduce, out;
    PhaseTaps half1, quarter1;

    Network(const Levels& at, const Layers& layers)
        : full(backward_taps(layers[kFullSecond], at.full)),
          half(backward_taps(layers[kHalfSecond], at.half)),
          quarter(backward_taps(layers[kQuarterSecond], at.quarter)),
          combined(backward_taps(layers[kLateralHalf], at.half)),
          lateral(backward_taps(layers[kLateralFull], at.full)),
          reduce(backward_taps(layers[kReduce], at.quarter)),
          out(backward_taps(layers[kOut], at.full)),
          half1(layers[kHalfFirst], at.half),
          quarter1(layers[kQuarterFirst], at.quarter) {}
};

class BackwardPass {
  public:
    BackwardPass(const Sizes& sizes, const Layers& layers, const Loops& loops, Team& team)
        : sizes_(sizes),
          at_(levels_of(sizes)),
          network_(at_, layers),
          loops_(loops),
          team_(team),
          scratch_size_(4 * kTile * phase_plane() + at_.full.pitch() + kLine),
          scratch_(scratch_size_ * team_.size()) {}

    // Computes the gradients of all maps, from the features to the first layer.
    void run(const std::vector<Image>& images) {
        const int count = static_cast<int>(images.size());
        for_bands(team_, count, at_.full, [&](int i, int from, int to, int) { read_features(images[i], from, to); });
        for_bands(team_, count, at_.full, [&](int i, int from, int to, int) {
            const GradientMaps& to_maps = images[i].gradients;
            convolve_rows(loops_, network_.out, to_maps.out, to_maps.merged, from, to, {});
            convolve_rows(loops_, network_.lateral, to_maps.merged, to_maps.full, from, to, band_input());
        });
        for_bands(team_, count, at_.half, [&](int i, int from, int to, int worker) {
            const GradientMaps& to_maps = images[i].gradients;
            loops_.upsampled_backward(to_maps.merged, to_maps.reduced_half, from, to, scratch(worker));
            close_rows(to_maps.reduced_half, from, to);
            convolve_rows(loops_, network_.combined, to_maps.reduced_half, to_maps.half, from, to, band_input());
        });
        for_bands(team_, count, at_.quarter, [&](int i, int from, int to, int worker) {
            const GradientMaps& to_maps = images[i].gradients;
            loops_.upsampled_backward(to_maps.reduced_half, to_maps.reduced_quarter, from, to, scratch(worker));
            close_rows(to_maps.reduced_quarter, from, to);
            Finish finish = band_input();
            finish.mask = &images[i].maps.quarter;
            convolve_rows(loops_, network_.reduce, to_maps.reduced_quarter, to_maps.quarter, from, to, finish);
        });
        rectified(images, at_.quarter, network_.quarter, &GradientMaps::quarter, &GradientMaps::quarter1,
                  &SavedMaps::quarter1);
        strided(images, at_.quarter, network_.quarter1, &GradientMaps::quarter1, &GradientMaps::half, &SavedMaps::half);
        rectified(images, at_.half, network_.half, &GradientMaps::half, &GradientMaps::half1, &SavedMaps::half1);
        strided(images, at_.half, network_.half1, &GradientMaps::half1, &GradientMaps::full, &SavedMaps::full);
        rectified(images, at_.full, network_.full, &GradientMaps::full, &GradientMaps::full1, &SavedMaps::full1);
    }

  private:
    static Finish band_input() {
        Finish out;
        out.is_band_input = true;
        return out;
    }

    static Finish masked(const Map& mask) {
        Finish out;
        out.mask = &mask;
        return out;
    }

    float* scratch(int worker) { return scratch_.data() + worker * scratch_size_; }

    std::size_t phase_plane() const { return kBandRows * at_.half.pitch(); }

    void read_features(const Image& image, int from, int to) {
        const Map& map = image.gradients.out;
        for (int y = from; y < to; ++y) {
            const std::size_t row = static_cast<std::size_t>(y) * map.level.width * sizes_.features;
            loops_.to_planes(image.grad_features + row, sizes_.features, map.level.width, map.row(0, y),
                             map.level.plane());
            for (int c = sizes_.features; c < map.channels; ++c) std::fill_n(map.row(c, y), map.level.width, 0.0f);
        }
        close_rows(map, from, to);
    }

    // Computes the gradient of a rectified map from that of the convolution with stride 1 that reads it.
    void rectified(const std::vector<Image>& images, const Level& level, const TapList& taps,
                   Map GradientMaps::* from_map, Map GradientMaps::* to_map, Map SavedMaps::* mask) {
        for_bands(team_, static_cast<int>(images.size()), level, [&](int i, int from, int to, int) {
            const Image& image = images[i];
            convolve_rows(loops_, taps, image.gradients.*from_map, image.gradients.*to_map, from, to,
                          masked(image.maps.*mask));
        });
    }

    // Adds the gradient from a convolution with stride 2 to that of the rectified map that it reads.
    void strided(const std::vector<Image>& images, const Level& coarse, const PhaseTaps& taps,
                 Map GradientMaps::* from_map, Map GradientMaps::* to_map, Map SavedMaps::* mask) {
        for_bands(team_, static_cast<int>(images.size()), coarse, [&](int i, int from, int to, int worker) {
            const Map &in = images[i].gradients.*from_map, &out = images[i].gradients.*to_map;
            const std::size_t plane = phase_plane(), at = coarse.row(from), span = coarse.span(from, to);
            float* phases = scratch(worker);
            for (int channel = 0; channel < out.channels; channel += kTile) {
                for (int phase = 0; phase < 4; ++phase) {
                    Taps tile = taps.lists[phase].taps();
                    tile.weights += static_cast<std::size_t>(channel) * tile.count;
                    float* to_phase = phases + phase * kTile * plane;
                    loops_.convolve({in.data + at, tile, nullptr, to_phase, plane, kTile, nullptr, false, false}, span);
                }
                loops_.add_phases(phases, plane, coarse, out, (images[i].maps.*mask).data, channel, from, to);
            }
        });
    }

    const Sizes& sizes_;
    const Levels at_;
    const Network network_;
    const Loops& loops_;
    Team& team_;
    std::size_t scratch_size_;
    Buffer<float> scratch_;
};

// The map that a layer reads, and the gradient of the map that it writes, in the order of the layers.
constexpr Map SavedMaps::* kInputs[kLayers] = {
    &SavedMaps::input,    &SavedMaps::full1, &SavedMaps::full_phases, &SavedMaps::half1,   &SavedMaps::half_phases,
    &SavedMaps::quarter1, &SavedMaps::half,  &SavedMaps::full,        &SavedMaps::quarter, &SavedMaps::merged};
constexpr Map GradientMaps::* kOutputs[kLayers] = {
    &GradientMaps::full1,    &GradientMaps::full,    &GradientMaps::half1,        &GradientMaps::half,
    &GradientMaps::quarter1, &GradientMaps::quarter, &GradientMaps::reduced_half, &GradientMaps::merged,
    &GradientMaps::reduced_quarter, &GradientMaps::out};

}  // namespace

void backward(const Sizes& sizes, const float* const* weights, const float* saved, const float* grad_features,
              const Execution& execution, float* const* out) {
    const Layers layers(sizes, weights);
    const Loops& loops = select_loops(execution.simd);
    Team team(execution.threads);
    BackwardPass pass(sizes, layers, loops, team);
    WeightSums sums(sizes, layers);
    MapArena count;
    place_gradients(sizes, count);
    const std::size_t kept = saved_size(sizes), own = count.used();
    const std::size_t values = static_cast<std::size_t>(sizes.out_height()) * sizes.out_width() * sizes.features;
    const int group = images_per_group(sizes.images, own);
    Buffer<float> memory(group * own);
    for (int first = 0; first < sizes.images; first += group) {
        std::vector<Image> found;
        for (int i = first; i < std::min(first + group, sizes.images); ++i) {
            MapArena arena(memory.data() + (i - first) * own);
            // The maps are only read.
            MapArena given(const_cast<float*>(saved) + i * kept);
            const SavedMaps maps = place_saved(sizes, given);
            found.push_back({grad_features + i * values, maps, place_gradients(sizes, arena)});
        }
        pass.run(found);
        std::vector<LayerMaps> maps;
        for (const Image& image : found) {
            for (int layer = 0; layer < kLayers; ++layer) {
                maps.push_back({image.maps.*kInputs[layer], image.gradients.*kOutputs[layer]});
            }
        }
        sums.add(maps, loops, team);
    }
    sums.write(layers, out);
}

}  // namespace fourd::encoder
