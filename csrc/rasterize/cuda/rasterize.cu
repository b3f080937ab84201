#include "rasterize/cuda/rasterize.h"

#include "device/arena.h"
#include "device/clear.h"
#include "device/executor.h"
#include "rasterize/cuda/cover.h"
#include "rasterize/gradient.h"

namespace fourd::rasterize::cuda {
namespace {

struct Workspace {
    std::uint64_t* keys;
    std::uint64_t* listed;
    std::uint32_t* count;

    Workspace(device::Arena& arena, std::size_t pixels, std::size_t items)
        : keys(arena.take<std::uint64_t>(pixels)),
          listed(arena.take<std::uint64_t>(items)),
          count(arena.take<std::uint32_t>(1)) {}
};

struct Start {
    Workspace workspace;

    FOURD_DEVICE void operator()(std::size_t index) const {
        workspace.keys[index] = kNoHit;
        if (index == 0) *workspace.count = 0;
    }
};

struct Shade {
    Query query;
    Target target;
    float* rast;
    float* rast_db;  // Null if the derivatives are not needed.

    FOURD_DEVICE void operator()(std::size_t index) const {
        float* const out = rast + 4 * index;
        float* const out_db = rast_db == nullptr ? nullptr : rast_db + 4 * index;
        for (int i = 0; i < 4; ++i) {
            out[i] = 0.0f;
            if (out_db != nullptr) out_db[i] = 0.0f;
        }
        const std::uint64_t key = target.keys[index];
        if (key == kNoHit) return;
        const std::size_t pixel = index % query.pixels();
        const int column = static_cast<int>(pixel % query.width), row = static_cast<int>(pixel / query.width);
        Triangle triangle;
        load_triangle(query, target.screen, index / query.pixels(), key & 0xffffffffu, &triangle);
        Piece piece = {{0, 0, 0}, {0, 0, 0}, triangle.index, 0, 0};
        for (int k = 0; k < 3; ++k) {
            piece.x[k] = triangle.snapped[k].x;
            piece.y[k] = triangle.snapped[k].y;
        }
        set_reference(target.screen, triangle.is_clipped(), bounds_of(target.screen, piece), &piece);
        const Planes planes = planes_of(target.screen, triangle, piece.reference_x, piece.reference_y);
        const float dx = static_cast<float>(column - piece.reference_x);
        const float dy = static_cast<float>(row - piece.reference_y);
        float at[3];
        for (int k = 0; k < 3; ++k) at[k] = plane_at(planes.c[k], planes.x[k], planes.y[k], dx, dy);
        const Weights weights = weights_of(at[0], at[1], at[2], planes.x, planes.y);
        out[0] = weights.u;
        out[1] = weights.v;
        out[2] = depth_of(key);
        out[3] = value_of_triangle(triangle.index);
        if (out_db == nullptr) return;
        out_db[0] = weights.u_x;
        out_db[1] = weights.u_y;
        out_db[2] = weights.v_x;
        out_db[3] = weights.v_y;
    }
};

struct Backward {
    Query query;
    Screen screen;
    const float* rast;
    const float* grad_rast;
    const float* grad_db;  // Null if the loss does not depend on rast_db.
    float* grad_pos;

    FOURD_DEVICE void operator()(std::size_t index) const {
        const int number = triangle_of_value(rast[4 * index + 3]);
        if (number < 0 || static_cast<std::size_t>(number) >= query.triangles) return;
        const std::size_t pixel = index % query.pixels(), image = index / query.pixels();
        const int column = static_cast<int>(pixel % query.width), row = static_cast<int>(pixel / query.width);
        Triangle triangle;
        if (!load_triangle(query, screen, image, static_cast<std::size_t>(number), &triangle)) return;
        const Planes planes = planes_of(screen, triangle, column, row);
        if (!planes.is_valid) return;
        const float* const grad = grad_rast + 4 * index;
        float sums[kSums], out[12];
        if (grad_db != nullptr) {
            pixel_gradient<true>(planes.c, planes.x, planes.y, grad[0], grad[1], grad_db + 4 * index, sums);
        } else {
            pixel_gradient<false>(planes.c, planes.x, planes.y, grad[0], grad[1], nullptr, sums);
        }
        vertex_gradients(screen, column, row, planes.c, planes.x, planes.y, planes.scale, sums, out);
        for (int k = 0; k < 3; ++k) {
            const std::size_t vertex = static_cast<std::size_t>(query.tri[3 * static_cast<std::size_t>(number) + k]);
            float* const to = grad_pos + 4 * (image * query.image_stride + vertex);
            device::atomic_add(to, out[4 * k]);
            device::atomic_add(to + 1, out[4 * k + 1]);
            device::atomic_add(to + 3, out[4 * k + 3]);
        }
    }
};

}  // namespace

std::size_t workspace_bytes(std::size_t images, std::size_t height, std::size_t width, std::size_t longest_range) {
    device::Arena arena(nullptr);
    Workspace(arena, images * height * width, images * longest_range);
    return arena.bytes();
}

void rasterize(const Query& query, std::size_t longest_range, void* workspace, const float* previous, float* rast,
               float* rast_db, void* stream) {
    const device::Executor executor(stream);
    const std::size_t images = static_cast<std::size_t>(query.images), pixels = images * query.pixels();
    device::Arena arena(workspace);
    const Workspace memory(arena, pixels, images * longest_range);
    const Items items{query, longest_range, memory.listed, memory.count};
    const Target target{make_screen(query.width, query.height), memory.keys, previous};
    executor.for_each(pixels, Start{memory});
    executor.for_each_in_warps(images * longest_range * device::kWarpSize, CoverSmall{items, target});
    const std::size_t columns = static_cast<std::size_t>((query.width + kTile - 1) / kTile);
    const std::size_t tiles = columns * static_cast<std::size_t>((query.height + kTile - 1) / kTile);
    executor.for_each_in_warps(images * tiles * device::kWarpSize,
                               CoverLarge{items, target, static_cast<int>(columns), tiles});
    executor.for_each(pixels, Shade{query, target, rast, rast_db});
}

void rasterize_backward(const Query& query, const float* rast, const float* grad_rast, const float* grad_db,
                        float* grad_pos, void* stream) {
    const device::Executor executor(stream);
    const std::size_t images = static_cast<std::size_t>(query.images);
    const std::size_t copies = query.image_stride == 0 ? 1 : images;
    executor.for_each(4 * copies * query.vertices, device::Clear{grad_pos});
    executor.for_each(images * query.pixels(), Backward{query, make_screen(query.width, query.height), rast, grad_rast,
                                                        grad_db, grad_pos});
}

}  // namespace fourd::rasterize::cuda
