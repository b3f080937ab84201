#include "heads/heads.h"

#include <algorithm>
#include <vector>

#include "common/buffer.h"
#include "common/team.h"
#include "heads/cpu/lines.h"
#include "heads/cpu/loops.h"

namespace fourd::heads {
namespace {

constexpr std::size_t kLeastPerTask = 16 * kBlock;
constexpr std::size_t kMaxTasks = 16;

// Divides one block of memory into arrays. Without memory, it only counts the floats.
class Arena {
  public:
    explicit Arena(float* memory = nullptr) : memory_(memory) {}

    float* take(std::size_t size) {
        const std::size_t at = used_;
        used_ += padded(static_cast<int>(size));
        return memory_ ? memory_ + at : nullptr;
    }
    std::size_t used() const { return used_; }

  private:
    float* memory_;
    std::size_t used_ = 0;
};

Packed place_packed(const Sizes& sizes, Arena& arena) {
    const std::size_t h = sizes.hidden_stride(), first = sizes.first_stride(), f = padded(sizes.features);
    const std::size_t c = padded(sizes.channels);
    Packed out;
    out.first = arena.take(first * f);
    out.first_columns = arena.take(f * first);
    out.first_bias = arena.take(first);
    out.second = arena.take(h * h);
    out.second_columns = arena.take(h * h);
    out.second_bias = arena.take(h);
    out.last = arena.take(2 * h);
    out.last_bias = arena.take(kPad);
    out.image = arena.take(h * c);
    out.image_columns = arena.take(c * h);
    out.out = arena.take(h);
    out.out_bias = arena.take(1);
    out.sh = arena.take(kSh * h);
    out.sh_columns = arena.take(h * kSh);
    out.sh_bias = arena.take(kSh);
    return out;
}

Sums place_sums(const Sizes& sizes, std::size_t knots, Arena& arena) {
    const std::size_t h = sizes.hidden_stride(), first = sizes.first_stride();
    Sums out;
    out.first_columns = arena.take(sizes.features * first);
    out.first_bias = arena.take(first);
    out.second = arena.take(h * h);
    out.second_bias = arena.take(h);
    out.last = arena.take(2 * h);
    out.last_bias = arena.take(kPad);
    out.image_columns = arena.take(sizes.channels * h);
    out.out = arena.take(h);
    out.out_bias = arena.take(1);
    out.sh = arena.take(kSh * h);
    out.sh_bias = arena.take(kSh);
    out.tables = arena.take(knots * first);
    return out;
}

Workspace place_workspace(const Sizes& sizes, Arena& arena) {
    const std::size_t h = sizes.hidden_stride(), first = sizes.first_stride(), f = padded(sizes.features);
    const std::size_t c = padded(sizes.channels), views = sizes.views;
    Workspace out;
    out.grad_first = arena.take(kBlock * first);
    out.back = arena.take(kBlock * h);
    out.wide = arena.take(kBlock * std::max(f, c));
    out.grad_last = arena.take(2 * kBlock);
    out.grad_sh = arena.take(kBlock * kSh);
    out.grad_logits = arena.take(views * kBlock);
    out.weights = arena.take(views * kBlock);
    out.grad_mixed = arena.take(views * 3 * kBlock);
    out.basis = arena.take(kShTerms * kBlock);
    out.grad_colour = arena.take(3 * kBlock);
    out.tanhs = arena.take(3 * kBlock);
    return out;
}

// The inputs of the first layers that are features, and not sampled from time planes.
std::vector<int> feature_columns(const Sizes& sizes, const TimePlanes& planes) {
    std::vector<char> is_feature(sizes.inputs, 1);
    for (int k = 0; k < planes.count; ++k) std::fill_n(&is_feature[planes.at[k].column], planes.features, 0);
    std::vector<int> out;
    for (int column = 0; column < sizes.inputs; ++column) {
        if (is_feature[column]) out.push_back(column);
    }
    return out;
}

// Copies a matrix of torch (outputs, inputs) to rows of `step` floats.
void copy_rows(const float* from, Shape shape, float* to, std::size_t step) {
    for (int r = 0; r < shape.rows; ++r) std::copy_n(from + r * shape.columns, shape.columns, to + r * step);
}

void copy_columns(const float* from, Shape shape, float* to, std::size_t step) {
    for (int r = 0; r < shape.rows; ++r) {
        for (int k = 0; k < shape.columns; ++k) to[k * step + r] = from[r * shape.columns + k];
    }
}

constexpr int kFirstLayers[3][2] = {
    {kGeometryFirst, kGeometryFirstBias}, {kBlendPoint, kBlendPointBias}, {kShFirst, kShFirstBias}};

// The weights in the layouts of the loops.
class PackedWeights {
  public:
    PackedWeights(const Sizes& sizes, const float* const* weights, const std::vector<int>& columns) {
        Arena count;
        place_packed(sizes, count);
        memory_ = Buffer<float>(count.used());
        std::fill_n(memory_.data(), memory_.size(), 0.0f);
        Arena arena(memory_.data());
        packed_ = place_packed(sizes, arena);
        const std::size_t h = sizes.hidden_stride(), first = sizes.first_stride(), f = padded(sizes.features);
        const auto shape = [&](int weight) { return weight_shape(sizes, weight); };
        for (int part = 0; part < 3; ++part) {
            const int weight = kFirstLayers[part][0];
            for (int r = 0; r < sizes.hidden; ++r) {
                for (int k = 0; k < sizes.features; ++k) {
                    const float value = weights[weight][r * sizes.inputs + columns[k]];
                    packed_.first[(part * h + r) * f + k] = packed_.first_columns[k * first + part * h + r] = value;
                }
            }
            std::copy_n(weights[kFirstLayers[part][1]], sizes.hidden, packed_.first_bias + part * h);
        }
        copy_rows(weights[kGeometrySecond], shape(kGeometrySecond), packed_.second, h);
        copy_columns(weights[kGeometrySecond], shape(kGeometrySecond), packed_.second_columns, h);
        copy_rows(weights[kGeometryLast], shape(kGeometryLast), packed_.last, h);
        copy_rows(weights[kBlendImage], shape(kBlendImage), packed_.image, padded(sizes.channels));
        copy_columns(weights[kBlendImage], shape(kBlendImage), packed_.image_columns, h);
        copy_rows(weights[kShLast], shape(kShLast), packed_.sh, h);
        copy_columns(weights[kShLast], shape(kShLast), packed_.sh_columns, kSh);
        std::copy_n(weights[kGeometrySecondBias], sizes.hidden, packed_.second_bias);
        std::copy_n(weights[kGeometryLastBias], 2, packed_.last_bias);
        std::copy_n(weights[kBlendOut], sizes.hidden, packed_.out);
        std::copy_n(weights[kBlendOutBias], 1, packed_.out_bias);
        std::copy_n(weights[kShLastBias], kSh, packed_.sh_bias);
    }

    const Packed& get() const { return packed_; }

  private:
    Buffer<float> memory_;
    Packed packed_;
};

// The number of points per task depends only on the number of points, so the order of all sums does not depend on the
// number of threads. At most kMaxTasks tasks have sums of their own.
std::size_t points_per_task(std::size_t count) {
    const std::size_t share = (count + kMaxTasks - 1) / kMaxTasks;
    return std::max(kLeastPerTask, (share + kBlock - 1) / kBlock * kBlock);
}

// Calls work(task, worker's workspace, first, count) for all blocks.
template <typename Work>
void for_blocks(Team& team, const Sizes& sizes, std::size_t points, const Work& work) {
    Arena count;
    place_workspace(sizes, count);
    Buffer<float> memory(count.used() * team.size());
    const std::size_t per_task = points_per_task(points);
    team.run(static_cast<int>((points + per_task - 1) / per_task), [&](int task, int worker) {
        Arena arena(memory.data() + worker * count.used());
        const Workspace space = place_workspace(sizes, arena);
        const std::size_t begin = task * per_task, end = std::min(points, begin + per_task);
        for (std::size_t first = begin; first < end; first += kBlock) {
            work(task, space, first, static_cast<int>(std::min<std::size_t>(kBlock, end - first)));
        }
    });
}

void copy_out_rows(const float* from, std::size_t step, Shape shape, float* to) {
    for (int r = 0; r < shape.rows; ++r) std::copy_n(from + r * step, shape.columns, to + r * shape.columns);
}

// Writes columns of `step` floats to a matrix of torch.
void copy_out_columns(const float* from, std::size_t step, Shape shape, float* to) {
    for (int r = 0; r < shape.rows; ++r) {
        for (int k = 0; k < shape.columns; ++k) to[r * shape.columns + k] = from[k * step + r];
    }
}

// Writes the sums to arrays in torch's shapes.
void unpack(const Sizes& sizes, const std::vector<int>& columns, const Sums& sums, float* const* out) {
    const std::size_t h = sizes.hidden_stride(), first = sizes.first_stride();
    const auto shape = [&](int weight) { return weight_shape(sizes, weight); };
    for (int part = 0; part < 3; ++part) {
        const int weight = kFirstLayers[part][0];
        for (int r = 0; r < sizes.hidden; ++r) {
            for (int k = 0; k < sizes.features; ++k) {
                out[weight][r * sizes.inputs + columns[k]] = sums.first_columns[k * first + part * h + r];
            }
        }
        std::copy_n(sums.first_bias + part * h, sizes.hidden, out[kFirstLayers[part][1]]);
    }
    copy_out_rows(sums.second, h, shape(kGeometrySecond), out[kGeometrySecond]);
    copy_out_rows(sums.last, h, shape(kGeometryLast), out[kGeometryLast]);
    copy_out_rows(sums.sh, h, shape(kShLast), out[kShLast]);
    copy_out_columns(sums.image_columns, h, shape(kBlendImage), out[kBlendImage]);
    std::copy_n(sums.second_bias, sizes.hidden, out[kGeometrySecondBias]);
    std::copy_n(sums.last_bias, 2, out[kGeometryLastBias]);
    std::copy_n(sums.out, sizes.hidden, out[kBlendOut]);
    std::copy_n(sums.out_bias, 1, out[kBlendOutBias]);
    std::copy_n(sums.sh_bias, kSh, out[kShLastBias]);
}

}  // namespace

void forward(const Sizes& sizes, const Settings& settings, const float* const* weights, const Inputs& inputs,
             const Execution& execution, const Outputs& out) {
    const Loops& loops = select_loops(execution.simd);
    const std::vector<int> columns = feature_columns(sizes, inputs.time_planes);
    const PackedWeights packed(sizes, weights, columns);
    const TimeTables tables(sizes, inputs.time_planes, weights, loops);
    const Job job{&sizes, &settings, &packed.get(), &inputs, tables.get()};
    Team team(execution.threads);
    for_blocks(team, sizes, inputs.count, [&](int, const Workspace& space, std::size_t first, int count) {
        loops.forward(job, space, first, count, out);
    });
}

void backward(const Sizes& sizes, const Settings& settings, const float* const* weights, const Inputs& inputs,
              const Execution& execution, const Saved& saved, const Upstream& upstream, const Gradients& out) {
    const Loops& loops = select_loops(execution.simd);
    const std::vector<int> columns = feature_columns(sizes, inputs.time_planes);
    const PackedWeights packed(sizes, weights, columns);
    const TimeTables tables(sizes, inputs.time_planes, weights, loops);
    const Job job{&sizes, &settings, &packed.get(), &inputs, tables.get()};
    Arena count;
    place_sums(sizes, tables.knots(), count);
    const std::size_t size = count.used(), per_task = points_per_task(inputs.count);
    const std::size_t tasks = std::max<std::size_t>(1, (inputs.count + per_task - 1) / per_task);
    Buffer<float> sums(tasks * size);
    if (inputs.count == 0) std::fill_n(sums.data(), sums.size(), 0.0f);
    Team team(execution.threads);
    for_blocks(team, sizes, inputs.count, [&](int task, const Workspace& space, std::size_t first, int count) {
        if (first == task * per_task) std::fill_n(sums.data() + task * size, size, 0.0f);
        Arena arena(sums.data() + task * size);
        loops.backward(job, space, first, count, saved, upstream, out,
                       place_sums(sizes, tables.knots(), arena));
    });
    // The sums of all tasks are added in the order of the tasks.
    run_parts(team, size, 4096, [&](std::size_t begin, std::size_t end) {
        for (std::size_t task = 1; task < tasks; ++task) {
            for (std::size_t i = begin; i < end; ++i) sums[i] += sums[task * size + i];
        }
    });
    Arena arena(sums.data());
    const Sums total = place_sums(sizes, tables.knots(), arena);
    unpack(sizes, columns, total, out.weights);
    if (tables.get()) tables.write_gradients(total.tables, out.time_planes, out.weights);
}

}  // namespace fourd::heads
