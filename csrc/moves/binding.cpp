// Python bindings of the updates of points and networks; fourd/rendering/ops/moves.py documents the functions.
#include "moves/moves.h"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <vector>

#include "binding/require.h"

namespace nb = nanobind;

namespace fourd {
namespace {

template <typename Number>
using Any = nb::ndarray<Number, nb::c_contig, nb::device::cpu>;
template <typename Number>
using List = nb::ndarray<Number, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <typename Number>
using Vectors = nb::ndarray<Number, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using RowList = List<const std::int64_t>;

moves::Rows rows_of(const RowList& rows, std::size_t points, int threads) {
    for (std::size_t i = 0; i < rows.size(); ++i) {
        require(rows.data()[i] >= 0 && static_cast<std::size_t>(rows.data()[i]) < points,
                "rows: expected indices of points");
    }
    return {rows.data(), rows.size(), clamp_threads(threads)};
}

void adam(const std::vector<Any<float>>& parameters, const std::vector<Any<const float>>& gradients,
          const std::vector<Any<float>>& firsts, const std::vector<Any<float>>& seconds,
          const std::vector<float>& step_sizes, const std::vector<float>& root_corrections, float beta1, float beta2,
          float epsilon, int threads) {
    const std::size_t count = parameters.size();
    require(gradients.size() == count && firsts.size() == count && seconds.size() == count &&
                step_sizes.size() == count && root_corrections.size() == count,
            "gradients: expected lists of equal lengths");
    std::vector<moves::Dense> arrays;
    for (std::size_t k = 0; k < count; ++k) {
        const std::size_t size = parameters[k].size();
        require(gradients[k].size() == size && firsts[k].size() == size && seconds[k].size() == size,
                "gradients: expected the parameters' sizes");
        arrays.push_back({parameters[k].data(), firsts[k].data(), seconds[k].data(), gradients[k].data(), size,
                          step_sizes[k], root_corrections[k]});
    }
    nb::gil_scoped_release release;
    moves::adam(arrays, {beta1, beta2}, epsilon, clamp_threads(threads));
}

void adam_rows(const RowList& rows, const List<float>& steps, const std::vector<Any<float>>& parameters,
               const std::vector<Any<float>>& moments, const std::vector<Any<const float>>& gradients,
               const std::vector<Any<const float>>& rates, const std::vector<float>& epsilons, float beta1, float beta2,
               int threads) {
    const std::size_t count = parameters.size(), points = steps.size();
    const moves::Rows checked = rows_of(rows, points, threads);
    require(moments.size() == count && gradients.size() == count && rates.size() == count && epsilons.size() == count,
            "gradients: expected lists of equal lengths");
    std::vector<moves::Sparse> arrays;
    for (std::size_t k = 0; k < count; ++k) {
        require(parameters[k].ndim() == 2 && parameters[k].shape(0) == points, "parameters: expected shape (N, C)");
        const std::size_t columns = parameters[k].shape(1);
        require(moments[k].size() == 2 * points * columns, "moments: expected shape (2, N, C)");
        require(gradients[k].size() == checked.count * columns, "gradients: expected shape (M, C)");
        require(rates[k].size() == 1 || rates[k].size() == checked.count, "rates: expected one number or (M,)");
        arrays.push_back({parameters[k].data(), moments[k].data(), moments[k].data() + points * columns,
                          gradients[k].data(), rates[k].data(), rates[k].size() == 1, static_cast<int>(columns),
                          epsilons[k]});
    }
    nb::gil_scoped_release release;
    moves::adam_rows(checked, steps.data(), arrays, {beta1, beta2});
}

void smooth(const RowList& rows, const Vectors<float>& xyz, const Any<const float>& planes,
            const List<const float>& spacing, const List<const float>& rates, float strength, float tolerance,
            float max_share, int threads) {
    const std::size_t points = xyz.shape(0);
    const moves::Rows checked = rows_of(rows, points, threads);
    require(planes.size() == 4 * points && spacing.size() == points && rates.size() == checked.count,
            "planes: expected shape (N, 4), and spacings and rates of all points and rows");
    nb::gil_scoped_release release;
    moves::smooth(checked, xyz.data(), {planes.data(), spacing.data(), rates.data(), strength, tolerance, max_share});
}

void keep_in_silhouettes(const RowList& rows, const Vectors<float>& xyz, const Vectors<const float>& before,
                         const std::vector<Any<const float>>& mattes, const std::vector<double>& cameras,
                         int threads) {
    const moves::Rows checked = rows_of(rows, xyz.shape(0), threads);
    require(before.shape(0) == checked.count, "before: expected one position for each row");
    std::vector<moves::Silhouette> views;
    const double* numbers = cameras.data();
    for (const Any<const float>& group : mattes) {
        require(group.ndim() == 3 && group.shape(1) >= 1 && group.shape(2) >= 1, "mattes: expected shape (V, H, W)");
        for (std::size_t view = 0; view < group.shape(0); ++view, numbers += 21) {
            require(cameras.size() >= 21 * (views.size() + 1), "cameras: expected 21 numbers for each matte");
            moves::Silhouette out;
            for (int i = 0; i < 9; ++i) out.camera.intrinsics[i] = static_cast<float>(numbers[i]);
            for (int i = 0; i < 9; ++i) out.camera.rotation[i] = static_cast<float>(numbers[9 + i]);
            for (int i = 0; i < 3; ++i) out.camera.translation[i] = static_cast<float>(numbers[18 + i]);
            out.height = static_cast<int>(group.shape(1)), out.width = static_cast<int>(group.shape(2));
            out.matte = group.data() + view * group.shape(1) * group.shape(2);
            views.push_back(out);
        }
    }
    nb::gil_scoped_release release;
    moves::keep_in_silhouettes(checked, xyz.data(), before.data(), views);
}

void keep_beyond(const RowList& rows, const Vectors<float>& xyz, const Vectors<const float>& before,
                 const std::vector<float>& axis, const std::vector<float>& centre, float near, int threads) {
    const moves::Rows checked = rows_of(rows, xyz.shape(0), threads);
    require(before.shape(0) == checked.count, "before: expected one position for each row");
    require(axis.size() == 3 && centre.size() == 3, "axis: expected three numbers, and so for the centre");
    nb::gil_scoped_release release;
    moves::keep_beyond(checked, xyz.data(), before.data(), axis.data(), centre.data(), near);
}

void add_magnitudes(const RowList& rows, const Vectors<const float>& gradient, const List<const float>& spacing,
                    const List<float>& sum, const List<float>& count, int threads) {
    const moves::Rows checked = rows_of(rows, spacing.size(), threads);
    require(gradient.shape(0) == checked.count, "gradient: expected one vector for each row");
    require(sum.size() == spacing.size() && count.size() == spacing.size(), "sum: expected one number for each point");
    nb::gil_scoped_release release;
    moves::add_magnitudes(checked, gradient.data(), spacing.data(), sum.data(), count.data());
}

}  // namespace

void bind_moves(nb::module_& module) {
    module.def("adam", &adam, nb::arg("parameters"), nb::arg("gradients"), nb::arg("firsts"), nb::arg("seconds"),
               nb::arg("step_sizes"), nb::arg("root_corrections"), nb::arg("beta1"), nb::arg("beta2"),
               nb::arg("epsilon"), nb::arg("threads"), "Sizes:");
    module.def("adam_rows", &adam_rows, nb::arg("rows"), nb::arg("steps"), nb::arg("parameters"), nb::arg("moments"),
               nb::arg("gradients"), nb::arg("rates"), nb::arg("epsilons"), nb::arg("beta1"), nb::arg("beta2"),
               nb::arg("threads"), "Sizes: rows=M steps=N");
    module.def("smooth_rows", &smooth, nb::arg("rows"), nb::arg("xyz"), nb::arg("planes"), nb::arg("spacing"),
               nb::arg("rates"), nb::arg("strength"), nb::arg("tolerance"), nb::arg("max_share"), nb::arg("threads"),
               "Sizes: rows=M xyz=N,3 planes=N,4 spacing=N rates=M");
    module.def("keep_in_silhouettes", &keep_in_silhouettes, nb::arg("rows"), nb::arg("xyz"), nb::arg("before"),
               nb::arg("mattes"), nb::arg("cameras"), nb::arg("threads"), "Sizes: rows=M xyz=N,3 before=M,3");
    module.def("keep_beyond", &keep_beyond, nb::arg("rows"), nb::arg("xyz"), nb::arg("before"), nb::arg("axis"),
               nb::arg("centre"), nb::arg("near"), nb::arg("threads"), "Sizes: rows=M xyz=N,3 before=M,3");
    module.def("add_magnitudes", &add_magnitudes, nb::arg("rows"), nb::arg("gradient"), nb::arg("spacing"),
               nb::arg("sum"), nb::arg("count"), nb::arg("threads"),
               "Sizes: rows=M gradient=M,3 spacing=N sum=N count=N");
}

}  // namespace fourd
