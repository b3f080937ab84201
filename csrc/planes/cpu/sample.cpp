#include <algorithm>
#include <cstring>
#include <vector>

#include "common/buffer.h"
#include "common/pages.h"
#include "common/team.h"
#include "planes/cpu/loops.h"

namespace fourd::planes {
namespace {

constexpr std::size_t kPointsPerTask = 16 * kRun;
constexpr std::size_t kCachedBytes = 1 << 20;
constexpr int kCellBits = 5;  // Space has 2^5 cells per axis. A cell covers 16 x 16 samples of a 512 x 512 plane.

std::size_t bytes_of(const Query& query, int k) {
    return static_cast<std::size_t>(query.planes[k].rows) * query.planes[k].columns * query.features * sizeof(float);
}

// Returns the index of the cell that contains a coordinate. The interval [-1, 1] has 2^kCellBits cells.
std::uint32_t cell_of(float coordinate) {
    return static_cast<std::uint32_t>(interpolate_axis(coordinate, (1 << kCellBits) + 1).low);
}

// Returns the indices of the points, sorted by spatial cell. Points of the same cell are sorted by index.
Buffer<std::uint32_t> order_by_cell(const Query& query) {
    constexpr std::size_t kCells = std::size_t{1} << (3 * kCellBits);
    Buffer<std::uint32_t> cells(query.count), order(query.count);
    std::vector<std::uint32_t> next_slot(kCells + 1, 0);
    for (std::size_t i = 0; i < query.count; ++i) {
        const float* at = query.coordinates + 4 * i;
        cells[i] = (cell_of(at[2]) << (2 * kCellBits)) | (cell_of(at[1]) << kCellBits) | cell_of(at[0]);
        ++next_slot[cells[i] + 1];
    }
    for (std::size_t cell = 0; cell < kCells; ++cell) next_slot[cell + 1] += next_slot[cell];
    for (std::size_t i = 0; i < query.count; ++i) order[next_slot[cells[i]]++] = static_cast<std::uint32_t>(i);
    return order;
}

// Owns the arrays of a Plan, and the memory that each worker needs for one batch.
class QueryPlan {
  public:
    QueryPlan(const Query& query, int workers) : order_(order_by_cell(query)) {
        for (int k = 0; k < query.plane_count; ++k) {
            x_axis_.push_back(axis_index({query.planes[k].x_axis, query.planes[k].columns}));
            y_axis_.push_back(axis_index({query.planes[k].y_axis, query.planes[k].rows}));
        }
        for (int k = 0; k < query.plane_count; ++k) {
            if (bytes_of(query, k) > kCachedBytes) large_.push_back(k);
        }
        const std::size_t size = axes_.size() * kRun;
        low_ = Buffer<int>(workers * size);
        fraction_ = Buffer<float>(workers * size);
        slope_ = Buffer<float>(workers * size);
        plan_ = {&query,         axes_.data(),  static_cast<int>(axes_.size()),  x_axis_.data(),
                 y_axis_.data(), large_.data(), static_cast<int>(large_.size()), order_.data()};
    }

    const Plan& plan() const { return plan_; }

    RunPositions positions(int worker) {
        const std::size_t at = worker * axes_.size() * kRun;
        return {low_.data() + at, fraction_.data() + at, slope_.data() + at};
    }

  private:
    int axis_index(Axis wanted) {
        const auto same = [&](const Axis& axis) {
            return axis.coordinate == wanted.coordinate && axis.size == wanted.size;
        };
        const auto found = std::find_if(axes_.begin(), axes_.end(), same);
        if (found != axes_.end()) return static_cast<int>(found - axes_.begin());
        axes_.push_back(wanted);
        return static_cast<int>(axes_.size()) - 1;
    }

    std::vector<Axis> axes_;
    std::vector<int> x_axis_, y_axis_, large_;
    Buffer<std::uint32_t> order_;
    Buffer<int> low_;
    Buffer<float> fraction_, slope_;
    Plan plan_{};
};

// Splits the points in [begin, end) into batches and calls work(begin, count) for each batch.
template <typename Work>
void for_runs(std::size_t begin, std::size_t end, const Work& work) {
    for (; begin < end; begin += kRun) work(begin, static_cast<int>(std::min<std::size_t>(kRun, end - begin)));
}

// Splits all points into batches and calls work(begin, count, worker) for each batch, on all workers of the team.
template <typename Work>
void for_all_runs(const Query& query, Team& team, const Work& work) {
    team.run(static_cast<int>((query.count + kPointsPerTask - 1) / kPointsPerTask), [&](int task, int worker) {
        const std::size_t begin = task * kPointsPerTask;
        for_runs(begin, std::min(query.count, begin + kPointsPerTask),
                 [&](std::size_t from, int count) { work(from, count, worker); });
    });
}

}  // namespace

void sample(const Query& query, float* out) {
    const RunLoops& loops = select_loops(query.simd).of(query.features);
    Team team(query.threads);
    QueryPlan planned(query, team.size());
    prefer_huge_pages(out, query.count * query.plane_count * query.features * sizeof(float));
    for_all_runs(query, team, [&](std::size_t begin, int count, int worker) {
        loops.sample(planned.plan(), begin, count, planned.positions(worker), out);
    });
}

void sample_backward(const Query& query, const float* gradient, float* const* grad_planes, float* grad_coordinates) {
    const RunLoops& loops = select_loops(query.simd).of(query.features);
    Team team(query.threads);
    QueryPlan planned(query, team.size());
    // Each worker has its own planes, so no locks are needed. It processes all points in order, so the order of
    // additions is fixed. It updates all its planes for one batch of points before the next batch, because the elements
    // of `gradient` for these planes share cache lines.
    const int parts = std::min(team.size(), query.plane_count);
    team.run(parts, [&](int part, int worker) {
        const int first = query.plane_count * part / parts, last = query.plane_count * (part + 1) / parts;
        for (int k = first; k < last; ++k) {
            prefer_huge_pages(grad_planes[k], bytes_of(query, k));
            std::memset(grad_planes[k], 0, bytes_of(query, k));
        }
        for_runs(0, query.count, [&](std::size_t begin, int count) {
            loops.scatter(planned.plan(), begin, count, planned.positions(worker), first, last, gradient, grad_planes);
        });
    });
    if (grad_coordinates == nullptr) return;
    for_all_runs(query, team, [&](std::size_t begin, int count, int worker) {
        loops.coordinate_gradient(planned.plan(), begin, count, planned.positions(worker), gradient, grad_coordinates);
    });
}

}  // namespace fourd::planes
