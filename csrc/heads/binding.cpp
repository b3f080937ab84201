// Python bindings of the point model's networks; fourd/rendering/ops/heads/op.py documents the operations.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <string>
#include <vector>

#include "binding/require.h"
#include "heads/heads.h"

namespace nb = nanobind;

namespace fourd {
namespace {

template <typename Number, std::size_t Axes>
using Array = nb::ndarray<Number, nb::ndim<Axes>, nb::c_contig, nb::device::cpu>;
template <typename Number>
using AnyArray = nb::ndarray<Number, nb::c_contig, nb::device::cpu>;

constexpr int kSettings = 11;

// The arguments that both passes have.
struct Call {
    heads::Sizes sizes;
    heads::Settings settings;
    std::vector<const float*> weights;
    std::vector<heads::TimePlane> planes;
    heads::Inputs inputs;
    heads::Execution execution;
};

// The planes over one coordinate of space and time: their values, the coordinates, and the first inputs of the layers
// that are their features.
struct PlaneArguments {
    const std::vector<Array<const float, 3>>& values;
    const std::vector<int>&axes, &columns;
    const std::optional<Array<const float, 2>>& coordinates;
    float time;
};

heads::Settings settings_of(const std::vector<float>& s) {
    require(s.size() == kSettings, "settings: expected 11 numbers");
    return {s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], {s[8], s[9], s[10]}};
}

template <typename Number>
void require_weights(const heads::Sizes& sizes, const std::vector<AnyArray<Number>>& weights) {
    require(weights.size() == heads::kWeightCount, "weights: expected 15 arrays");
    for (int i = 0; i < heads::kWeightCount; ++i) {
        const heads::Shape shape = heads::weight_shape(sizes, i);
        require(weights[i].size() == static_cast<std::size_t>(shape.rows) * shape.columns,
                "weights: expected the shapes of the layers");
    }
}

std::vector<heads::TimePlane> planes_of(const PlaneArguments& from, std::size_t count, int inputs) {
    require(from.axes.size() == from.values.size() && from.columns.size() == from.values.size(),
            "axes, columns: expected one number for each time plane");
    require(from.values.empty() || (from.coordinates && from.coordinates->shape(0) == count &&
                                    from.coordinates->shape(1) == 4),
            "coordinates: expected shape (points, 4)");
    std::vector<heads::TimePlane> out;
    std::vector<bool> is_taken(inputs, false);
    std::size_t samples = 0;
    for (std::size_t k = 0; k < from.values.size(); ++k) {
        const Array<const float, 3>& plane = from.values[k];
        const std::size_t features = plane.shape(2);
        samples += plane.shape(1);
        require(plane.shape(0) >= 2 && plane.shape(1) >= 2 && samples <= heads::kMaxTimeSamples &&
                    plane.shape(0) <= 0x7fffffff && features >= 1 && features == from.values[0].shape(2),
                "planes: expected shapes (rows, samples, features) with at least 2 rows and 2 samples, and in all "
                "planes together at most 65536 samples");
        require(from.axes[k] >= 0 && from.axes[k] <= 2, "axes: expected 0, 1 or 2");
        const int column = from.columns[k];
        require(column >= 0 && column <= inputs && features <= static_cast<std::size_t>(inputs - column),
                "columns: expected inputs of the first layers");
        for (std::size_t f = 0; f < features; ++f) {
            require(!is_taken[column + f], "columns: expected different inputs for different planes");
            is_taken[column + f] = true;
        }
        out.push_back({plane.data(), static_cast<int>(plane.shape(0)), static_cast<int>(plane.shape(1)), from.axes[k],
                       column});
    }
    return out;
}

Call call_of(const Array<const float, 2>& features, const Array<const float, 3>& samples,
             const Array<const float, 2>& visibility, const Array<const float, 1>& view_weights,
             const std::optional<Array<const float, 2>>& own, const Array<const float, 2>& xyz,
             const Array<const float, 1>& spacing, const PlaneArguments& time_planes,
             const std::vector<AnyArray<const float>>& weights, const std::vector<float>& settings, int threads,
             const std::string& simd) {
    const std::size_t count = features.shape(0);
    require(count <= 0x7fffffff, "features: expected at most 2^31 - 1 points");
    require(features.shape(1) >= 1 && features.shape(1) <= heads::kMaxFeatures, "features: expected 1 to 4096");
    require(samples.shape(2) == count, "samples: expected shape (views, channels, points)");
    require(samples.shape(0) >= 1 && samples.shape(0) <= heads::kMaxViews, "samples: expected 1 to 64 views");
    require(samples.shape(1) >= 3 && samples.shape(1) <= heads::kMaxChannels, "samples: expected 3 to 64 channels");
    require(visibility.shape(0) == samples.shape(0) && visibility.shape(1) == count,
            "visibility: expected shape (views, points)");
    require(view_weights.shape(0) == samples.shape(0), "view_weights: expected one number for each view");
    require(!own || (own->shape(0) == count && own->shape(1) == 3), "own: expected shape (points, 3)");
    require(xyz.shape(0) == count && xyz.shape(1) == 3, "xyz: expected shape (points, 3)");
    require(spacing.shape(0) == count, "spacing: expected one number for each point");
    require(weights.size() == heads::kWeightCount, "weights: expected 15 arrays");
    const std::size_t hidden = weights[heads::kGeometryFirstBias].size();
    require(hidden >= 1 && hidden <= heads::kMaxHidden, "weights: expected a hidden layer of width 1 to 512");
    const int width = static_cast<int>(features.shape(1));
    const auto& planes = time_planes.values;
    const std::size_t added = planes.empty() ? 0 : planes.size() * planes[0].shape(2);
    require(added <= heads::kMaxFeatures, "planes: expected at most 4096 features");
    const heads::Sizes sizes{width, static_cast<int>(hidden), static_cast<int>(samples.shape(1)),
                             static_cast<int>(samples.shape(0)), width + static_cast<int>(added)};
    require_weights(sizes, weights);
    Call out{sizes, settings_of(settings), {}, planes_of(time_planes, count, sizes.inputs), {}, {}};
    for (const AnyArray<const float>& weight : weights) out.weights.push_back(weight.data());
    out.inputs = {features.data(),
                  samples.data(),
                  visibility.data(),
                  view_weights.data(),
                  own ? own->data() : nullptr,
                  xyz.data(),
                  spacing.data(),
                  count,
                  {out.planes.data(), static_cast<int>(out.planes.size()),
                   planes.empty() ? 0 : static_cast<int>(planes[0].shape(2)),
                   time_planes.coordinates ? time_planes.coordinates->data() : nullptr, time_planes.time}};
    out.execution = {clamp_threads(threads), simd_named(simd.c_str())};
    return out;
}

template <typename Number>
void require_outputs(const Call& call, const Array<Number, 1>& radius, const Array<Number, 1>& density,
                     const Array<Number, 2>& colour) {
    const std::size_t count = call.inputs.count;
    require(radius.size() == count && density.size() == count, "radius, density: expected one number for each point");
    require(colour.shape(0) == count && colour.shape(1) == 3, "colour: expected shape (points, 3)");
}

void require_saved(const Call& call, std::size_t sh, std::size_t saved) {
    require(sh == call.inputs.count * heads::kSh, "sh: expected shape (points, 48)");
    require(saved == call.sizes.saved_size(call.inputs.count),
            "saved: expected views + 4 * hidden numbers for each point, with hidden padded to a multiple of 16");
}

void forward(const Array<const float, 2>& features, const Array<const float, 3>& samples,
             const Array<const float, 2>& visibility, const Array<const float, 1>& view_weights,
             const std::optional<Array<const float, 2>>& own, const Array<const float, 2>& xyz,
             const Array<const float, 1>& spacing, const std::vector<Array<const float, 3>>& planes,
             const std::vector<int>& axes, const std::vector<int>& columns,
             const std::optional<Array<const float, 2>>& coordinates, float time,
             const std::vector<AnyArray<const float>>& weights, const std::vector<float>& settings, int threads,
             const std::string& simd, const Array<float, 1>& radius,
             const Array<float, 1>& density, const Array<float, 2>& sh, const Array<float, 2>& colour,
             const Array<float, 1>& saved) {
    const Call call = call_of(features, samples, visibility, view_weights, own, xyz, spacing,
                              {planes, axes, columns, coordinates, time}, weights, settings, threads, simd);
    require_outputs(call, radius, density, colour);
    require_saved(call, sh.size(), saved.size());
    nb::gil_scoped_release release;
    heads::forward(call.sizes, call.settings, call.weights.data(), call.inputs, call.execution,
                   {radius.data(), density.data(), sh.data(), colour.data(), saved.data()});
}

void backward(const Array<const float, 2>& features, const Array<const float, 3>& samples,
              const Array<const float, 2>& visibility, const Array<const float, 1>& view_weights,
              const std::optional<Array<const float, 2>>& own, const Array<const float, 2>& xyz,
              const Array<const float, 1>& spacing, const std::vector<Array<const float, 3>>& planes,
              const std::vector<int>& axes, const std::vector<int>& columns,
              const std::optional<Array<const float, 2>>& coordinates, float time,
              const std::vector<AnyArray<const float>>& weights, const std::vector<float>& settings, int threads,
              const std::string& simd,
              const Array<const float, 1>& radius, const Array<const float, 1>& density,
              const std::optional<Array<const float, 2>>& grad_sh, const Array<const float, 2>& colour,
              const Array<const float, 2>& sh, const Array<const float, 1>& saved, const Array<float, 2>& out_features,
              const Array<float, 3>& out_samples, const std::optional<Array<float, 2>>& out_own,
              const Array<float, 2>& out_xyz, const std::vector<Array<float, 3>>& out_planes,
              const std::vector<AnyArray<float>>& out_weights) {
    const Call call = call_of(features, samples, visibility, view_weights, own, xyz, spacing,
                              {planes, axes, columns, coordinates, time}, weights, settings, threads, simd);
    require_outputs(call, radius, density, colour);
    require(!grad_sh || grad_sh->size() == call.inputs.count * heads::kSh, "grad_sh: expected shape (points, 48)");
    require_saved(call, sh.size(), saved.size());
    require(out_features.size() == features.size() && out_samples.size() == samples.size() &&
                out_xyz.size() == xyz.size() && own.has_value() == out_own.has_value() &&
                (!own || out_own->size() == own->size()),
            "gradients: expected the shapes of the inputs");
    require_weights(call.sizes, out_weights);
    require(out_planes.size() == planes.size(), "out_planes: expected one array for each time plane");
    std::vector<float*> to_planes;
    for (std::size_t k = 0; k < planes.size(); ++k) {
        require(out_planes[k].size() == planes[k].size(), "out_planes: expected the shapes of the time planes");
        to_planes.push_back(out_planes[k].data());
    }
    heads::Gradients out{out_features.data(), out_samples.data(), own ? out_own->data() : nullptr,
                         out_xyz.data(),      {},                 to_planes.data()};
    for (int i = 0; i < heads::kWeightCount; ++i) out.weights[i] = out_weights[i].data();
    nb::gil_scoped_release release;
    heads::backward(call.sizes, call.settings, call.weights.data(), call.inputs, call.execution,
                    {sh.data(), saved.data()},
                    {radius.data(), density.data(), grad_sh ? grad_sh->data() : nullptr, colour.data()}, out);
}

}  // namespace

void bind_heads(nb::module_& module) {
    module.def("evaluate_heads", &forward, nb::arg("features"), nb::arg("samples"), nb::arg("visibility"),
               nb::arg("view_weights"), nb::arg("own").none(), nb::arg("xyz"), nb::arg("spacing"), nb::arg("planes"),
               nb::arg("axes"), nb::arg("columns"), nb::arg("coordinates").none(), nb::arg("time"), nb::arg("weights"),
               nb::arg("settings"), nb::arg("threads"), nb::arg("simd"), nb::arg("radius"), nb::arg("density"),
               nb::arg("sh"), nb::arg("colour"), nb::arg("saved"),
               "Sizes: features=N,F samples=V,C,N visibility=V,N view_weights=V own=N,3 xyz=N,3 spacing=N "
               "coordinates=N,4 radius=N density=N sh=N,48 colour=N,3");
    module.def("evaluate_heads_backward", &backward, nb::arg("features"), nb::arg("samples"), nb::arg("visibility"),
               nb::arg("view_weights"), nb::arg("own").none(), nb::arg("xyz"), nb::arg("spacing"), nb::arg("planes"),
               nb::arg("axes"), nb::arg("columns"), nb::arg("coordinates").none(), nb::arg("time"), nb::arg("weights"),
               nb::arg("settings"), nb::arg("threads"), nb::arg("simd"), nb::arg("grad_radius"),
               nb::arg("grad_density"), nb::arg("grad_sh").none(), nb::arg("grad_colour"), nb::arg("sh"),
               nb::arg("saved"), nb::arg("out_features"), nb::arg("out_samples"), nb::arg("out_own").none(),
               nb::arg("out_xyz"),
               nb::arg("out_planes"), nb::arg("out_weights"),
               "Sizes: features=N,F samples=V,C,N visibility=V,N view_weights=V own=N,3 xyz=N,3 spacing=N "
               "coordinates=N,4 "
               "grad_radius=N grad_density=N grad_sh=N,48 grad_colour=N,3 sh=N,48 out_features=N,F out_samples=V,C,N "
               "out_own=N,3 out_xyz=N,3");
}

}  // namespace fourd
