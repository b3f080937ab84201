#include "binding/convert.h"

#include <algorithm>
#include <stdexcept>

namespace fourd {
namespace {

constexpr int kMostThreads = 256;

}  // namespace

void require(bool condition, const char* message) {
    if (!condition) throw std::invalid_argument(message);
}

points::Settings points_settings(const std::vector<double>& camera, std::size_t width, std::size_t height, int layers,
                                 double near, double transmittance_min, int threads, const std::string& simd) {
    constexpr std::size_t kLongest = points::kLongestSide;
    const bool sized = width >= 1 && height >= 1 && width <= kLongest && height <= kLongest;
    require(camera.size() == 21 && sized && layers >= 1 && near > 0 && threads >= 1,
            "camera, width, height, layers, near, threads: out of range");
    points::Settings settings;
    for (int i = 0; i < 9; ++i) settings.camera.intrinsics[i] = static_cast<float>(camera[i]);
    for (int i = 0; i < 9; ++i) settings.camera.rotation[i] = static_cast<float>(camera[9 + i]);
    for (int i = 0; i < 3; ++i) settings.camera.translation[i] = static_cast<float>(camera[18 + i]);
    settings.camera.width = static_cast<int>(width);
    settings.camera.height = static_cast<int>(height);
    settings.near = static_cast<float>(near);
    settings.layers = layers;
    settings.transmittance_min = static_cast<float>(transmittance_min);
    settings.threads = std::min(threads, kMostThreads);
    settings.simd = simd_named(simd.c_str());
    return settings;
}

shade::Settings shade_settings(const ChosenArray& chosen, std::size_t views, const CentreArray& centre, float sh_range,
                               float sh_base, int threads, const std::string& simd) {
    require(chosen.shape(0) <= shade::kMaxChosen, "chosen: expected at most 64 views");
    for (std::size_t i = 0; i < chosen.shape(0); ++i) {
        require(chosen.data()[i] >= 0 && static_cast<std::size_t>(chosen.data()[i]) < views,
                "chosen: expected indices of source views");
    }
    return {chosen.data(),
            static_cast<int>(chosen.shape(0)),
            {centre.data()[0], centre.data()[1], centre.data()[2]},
            sh_range,
            sh_base,
            std::clamp(threads, 1, kMostThreads),
            simd_named(simd.c_str())};
}

}  // namespace fourd
