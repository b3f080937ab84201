#include <vector>

#include "common/buffer.h"
#include "encoder/cpu/bands.h"
#include "encoder/encoder.h"

namespace fourd::encoder {

Shape weight_shape(const Sizes& sizes, int weight) {
    const Shape shapes[kLayers] = {
        {kFull, kColours, 3},    {kFull, kFull, 3},      {kHalf, kFull, 3},    {kHalf, kHalf, 3},
        {kQuarter, kHalf, 3},    {kQuarter, kQuarter, 3}, {kQuarter, kHalf, 1}, {kMerged, kFull, 1},
        {kMerged, kQuarter, 1},  {sizes.features, kMerged, 3},
    };
    const Shape& shape = shapes[weight / 2];
    return weight % 2 == 0 ? shape : Shape{shape.outputs, 1, 1};
}

std::size_t saved_size(const Sizes& sizes) {
    MapArena arena;
    place_saved(sizes, arena);
    return arena.used();
}

namespace {

// The maps of one image, its input and its result.
struct Image {
    const float* pixels;
    float* features;
    SavedMaps maps;
    ForwardMaps reduced;
};

struct Network {
    TapList full1, full, half1, half, quarter1, quarter, combined, lateral, reduce, out;
    Buffer<float> out_bias;  // Padded to whole tiles.

    Network(const Sizes& sizes, const Layers& layers) : out_bias(padded(sizes.features)) {
        const Levels at = levels_of(sizes);
        full1 = forward_taps(layers[kFullFirst], at.full, 1);
        full = forward_taps(layers[kFullSecond], at.full, 1);
        half1 = forward_taps(layers[kHalfFirst], at.half, 2);
        half = forward_taps(layers[kHalfSecond], at.half, 1);
        quarter1 = forward_taps(layers[kQuarterFirst], at.quarter, 2);
        quarter = forward_taps(layers[kQuarterSecond], at.quarter, 1);
        combined = forward_taps(layers[kLateralHalf], at.half, 1);
        lateral = forward_taps(layers[kLateralFull], at.full, 1);
        reduce = forward_taps(layers[kReduce], at.quarter, 1);
        out = forward_taps(layers[kOut], at.full, 1);
        std::fill_n(out_bias.data(), out_bias.size(), 0.0f);
        std::copy_n(layers[kOut].bias, sizes.features, out_bias.data());
    }
};

class ForwardPass {
  public:
    ForwardPass(const Sizes& sizes, const Layers& layers, const Execution& execution)
        : sizes_(sizes),
          at_(levels_of(sizes)),
          layers_(layers),
          network_(sizes, layers),
          loops_(select_loops(execution.simd)),
          team_(execution.threads),
          scratch_size_(padded(sizes.features) * band_plane() + at_.full.pitch() + kLine),
          scratch_(scratch_size_ * team_.size()) {}

    void run(const std::vector<Image>& images) {
        const int count = static_cast<int>(images.size());
        for_bands(team_, count, at_.full, [&](int i, int from, int to, int) {
            const Map& input = images[i].maps.input;
            loops_.pool(images[i].pixels, sizes_.height, sizes_.width, sizes_.stride, input, from, to);
            close_rows(input, from, to);
        });
        rectified(images, at_.full, network_.full1, kFullFirst, &SavedMaps::input, &SavedMaps::full1);
        rectified(images, at_.full, network_.full, kFullSecond, &SavedMaps::full1, &SavedMaps::full,
                  &SavedMaps::full_phases);
        rectified(images, at_.half, network_.half1, kHalfFirst, &SavedMaps::full_phases, &SavedMaps::half1);
        rectified(images, at_.half, network_.half, kHalfSecond, &SavedMaps::half1, &SavedMaps::half,
                  &SavedMaps::half_phases);
        rectified(images, at_.quarter, network_.quarter1, kQuarterFirst, &SavedMaps::half_phases,
                  &SavedMaps::quarter1);
        for_bands(team_, count, at_.quarter, [&](int i, int from, int to, int) {
            const SavedMaps& maps = images[i].maps;
            convolve_rows(loops_, network_.quarter, maps.quarter1, maps.quarter, from, to,
                          rectify(layers_[kQuarterSecond].bias));
            Finish finish;
            finish.is_band_input = true;
            convolve_rows(loops_, network_.reduce, maps.quarter, images[i].reduced.quarter, from, to, finish);
        });
        for_bands(team_, count, at_.half, [&](int i, int from, int to, int worker) {
            const ForwardMaps& reduced = images[i].reduced;
            merge(network_.combined, kLateralHalf, images[i].maps.half, reduced.quarter, reduced.half, from, to,
                  worker);
        });
        for_bands(team_, count, at_.full, [&](int i, int from, int to, int worker) {
            const SavedMaps& maps = images[i].maps;
            merge(network_.lateral, kLateralFull, maps.full, images[i].reduced.half, maps.merged, from, to, worker);
        });
        for_bands(team_, count, at_.full, [&](int i, int from, int to, int worker) {
            write_features(images[i], from, to, worker);
        });
    }

  private:
    static Finish rectify(const float* bias) {
        Finish out;
        out.bias = bias;
        out.rectifies = true;
        return out;
    }

    float* scratch(int worker) { return scratch_.data() + worker * scratch_size_; }

    std::size_t band_plane() const { return kBandRows * at_.full.pitch(); }

    // Computes a layer with a ReLU and, if `phases` is not null, the phases of its output.
    void rectified(const std::vector<Image>& images, const Level& level, const TapList& taps, int weight,
                   Map SavedMaps::* in, Map SavedMaps::* out, Map SavedMaps::* phases = nullptr) {
        for_bands(team_, static_cast<int>(images.size()), level, [&](int i, int from, int to, int) {
            const SavedMaps& maps = images[i].maps;
            convolve_rows(loops_, taps, maps.*in, maps.*out, from, to, rectify(layers_[weight].bias));
            if (!phases) return;
            loops_.split_phases(maps.*out, maps.*phases, from / 2, to / 2);
            close_rows(maps.*phases, from / 2, to / 2);
        });
    }

    // Adds a layer's output and the upsampled map of the coarser level.
    void merge(const TapList& taps, int weight, const Map& in, const Map& coarse, const Map& out, int from, int to,
               int worker) {
        Finish finish;
        finish.bias = layers_[weight].bias;
        convolve_rows(loops_, taps, in, out, from, to, finish);
        loops_.add_upsampled(coarse, out, from, to, scratch(worker));
    }

    void write_features(const Image& image, int from, int to, int worker) {
        const std::size_t at = at_.full.row(from), plane = band_plane();
        float* planes = scratch(worker);
        loops_.convolve({image.maps.merged.data + at, network_.out.taps(), network_.out_bias.data(), planes, plane,
                         network_.out.channels(), nullptr, false, false},
                        at_.full.span(from, to));
        for (int y = from; y < to; ++y) {
            loops_.to_pixels(planes + (y - from) * at_.full.pitch(), plane, sizes_.features, at_.full.width,
                             image.features + static_cast<std::size_t>(y) * at_.full.width * sizes_.features);
        }
    }

    const Sizes& sizes_;
    const Levels at_;
    const Layers& layers_;
    const Network network_;
    const Loops& loops_;
    Team team_;
    std::size_t scratch_size_;
    Buffer<float> scratch_;
};

}  // namespace

void forward(const Sizes& sizes, const float* const* weights, const float* images, const Execution& execution,
             float* features, float* saved) {
    const Layers layers(sizes, weights);
    ForwardPass pass(sizes, layers, execution);
    MapArena count;
    place_forward(sizes, count);
    const std::size_t kept = saved_size(sizes), own = count.used() + (saved ? 0 : kept);
    const std::size_t pixels = static_cast<std::size_t>(kColours) * sizes.height * sizes.width;
    const std::size_t values = static_cast<std::size_t>(sizes.out_height()) * sizes.out_width() * sizes.features;
    const int group = images_per_group(sizes.images, own);
    Buffer<float> memory(group * own);
    for (int first = 0; first < sizes.images; first += group) {
        std::vector<Image> found;
        for (int i = first; i < std::min(first + group, sizes.images); ++i) {
            MapArena arena(memory.data() + (i - first) * own), given(saved ? saved + i * kept : nullptr);
            const SavedMaps maps = place_saved(sizes, saved ? given : arena);
            found.push_back({images + i * pixels, features + i * values, maps, place_forward(sizes, arena)});
        }
        pass.run(found);
    }
}

}  // namespace fourd::encoder
