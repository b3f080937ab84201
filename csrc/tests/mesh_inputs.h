// Random meshes for the rasterizer, the interpolation and ray tracing. Some vertices and indices are invalid.
#pragma once

#include <algorithm>
#include <cstdint>

#include "common/triangle_id.h"
#include "interpolate/interpolate.h"
#include "rasterize/rasterize.h"
#include "rays/discs.h"
#include "rays/rays.h"
#include "tests/random_inputs.h"

namespace fourd::tests {

struct MeshInputs {
    Floats pos, attr;
    std::vector<std::int32_t> tri, ranges, diff;
    rasterize::Query query{};
    Floats rast, rast_db, grad_rast, grad_db, grad_pos;
    Floats out, out_da, grad_attr, from_rast, from_db;  // Results of the interpolation.

    MeshInputs(Random& random, int max_side, float hostile) {
        const int images = random_int(random, 0, 3), height = random_int(random, 1, max_side);
        const int width = random_int(random, 1, max_side), vertices = random_int(random, 0, 30);
        const int triangles = random_int(random, 0, 60);
        const bool has_ranges = random_int(random, 0, 1) == 1;
        const std::size_t copies = has_ranges ? 1 : images;
        pos = random_floats(random, 4 * copies * vertices, -1, 1, hostile);
        for (int i = 0; i < 3 * triangles; ++i) {
            tri.push_back(random_int(random, hostile > 0 ? -1 : 0, hostile > 0 ? vertices : std::max(vertices - 1, 0)));
        }
        for (int i = 0; i < 2 * images; ++i) ranges.push_back(random_int(random, -1, triangles + 1));
        const std::size_t pixels = static_cast<std::size_t>(images) * height * width;
        query = {pos.data(),
                 static_cast<std::size_t>(vertices),
                 has_ranges ? 0 : static_cast<std::size_t>(vertices),
                 tri.data(),
                 static_cast<std::size_t>(triangles),
                 has_ranges ? ranges.data() : nullptr,
                 images,
                 height,
                 width,
                 random_int(random, 1, 4),
                 Simd::baseline};
        rast.resize(4 * pixels), rast_db.resize(4 * pixels), grad_pos.resize(pos.size());
        grad_rast = random_floats(random, 4 * pixels, -1, 1, 0);
        grad_db = random_floats(random, 4 * pixels, -1, 1, 0);
        const int channels = random_int(random, 1, 5);
        attr = random_floats(random, copies * vertices * channels, -1, 1, 0);
        for (int i = random_int(random, 0, 3); i > 0; --i) diff.push_back(random_int(random, 0, channels - 1));
        out.resize(pixels * channels), out_da.resize(2 * pixels * diff.size()), grad_attr.resize(attr.size());
        from_rast.resize(4 * pixels), from_db.resize(4 * pixels);
    }

    // Replaces the triangle of each pixel by a random index, which may be -1 (no triangle) or too large.
    void invent_triangles(Random& random) {
        for (std::size_t i = 3; i < rast.size(); i += 4) {
            rast[i] = value_of_triangle(random_int(random, -1, static_cast<int>(query.triangles)));
        }
    }

    interpolate::Query interpolation() const {
        const std::size_t pixels = rast.size() / 4;
        const std::size_t channels = pixels > 0 ? out.size() / pixels : 1;
        return {attr.data(),  query.vertices, channels,    query.image_stride, query.tri,
                query.triangles, rast.data(), rast_db.data(), query.images,    query.height,
                query.width,  diff.data(),    diff.size(), query.threads,      query.simd};
    }

    interpolate::Gradients gradients() {
        return {out.data(), out_da.data(), grad_attr.data(), from_rast.data(), from_db.data()};
    }

    void expect_finite_results(unsigned seed) const {
        expect_finite(rast, "rasterization", seed);
        expect_finite(rast_db, "derivatives of weights", seed);
        expect_finite(grad_pos, "gradient of positions", seed);
        expect_finite(out, "interpolated attributes", seed);
    }
};

// A mesh for ray tracing, and rays. Vertices, origins, directions and limits may be infinite or NaN.
struct RayInputs {
    Floats xyz, origins, directions, limits, after_t;
    std::vector<std::int32_t> tri, after_triangle, triangle;
    int layers;
    Floats t, u, v, to_xyz, to_origins, to_directions, to_hits;
    std::vector<std::uint8_t> flags;
    rays::Rays query{};

    RayInputs(Random& random, int max_triangles, float hostile, const char* simd) {
        const int vertices = random_int(random, 1, 60), triangles = random_int(random, 0, max_triangles);
        const std::size_t count = random_int(random, 0, 200);
        layers = random_int(random, 1, 9);
        xyz = random_floats(random, 3 * static_cast<std::size_t>(vertices), -1, 1, hostile);
        const int outside = hostile > 0 ? 1 : 0;  // If 1, some triangles have vertex indices out of range.
        for (int i = 0; i < 3 * triangles; ++i) tri.push_back(random_int(random, -outside, vertices - 1 + outside));
        origins = random_floats(random, 3 * count, -2, 2, hostile);
        directions = random_floats(random, 3 * count, -1, 1, hostile);
        limits = random_floats(random, 2 * count + 1, -2, 4, hostile);
        after_t = random_floats(random, count, -1, 2, hostile);
        for (std::size_t i = 0; i < count; ++i) after_triangle.push_back(random_int(random, -1, triangles));
        const std::size_t hits = count * layers;
        t.resize(hits), u.resize(hits), v.resize(hits), triangle.resize(hits), flags.resize(count);
        to_xyz.resize(xyz.size()), to_origins.resize(3 * count), to_directions.resize(3 * count);
        to_hits = random_floats(random, hits, -1, 1, 0);
        const bool is_continued = random_int(random, 0, 1) == 1;
        query = {origins.data(), directions.data(), count, limits.data(), std::size_t(random_int(random, 0, 1)),
                 limits.data() + count, std::size_t(random_int(random, 0, 1)),
                 is_continued ? after_t.data() : nullptr, is_continued ? after_triangle.data() : nullptr,
                 random_int(random, 1, 4), simd_named(simd)};
    }

    rays::Mesh mesh() const { return {xyz.data(), xyz.size() / 3, tri.data(), tri.size() / 3}; }

    rays::Hits hits() { return {layers, t.data(), u.data(), v.data(), triangle.data()}; }

    rays::HitGradients gradients() {
        return {origins.data(), directions.data(), query.count, layers, t.data(), u.data(), v.data(), triangle.data(),
                to_hits.data(), to_hits.data(), to_hits.data(), to_xyz.data(), to_origins.data(), to_directions.data(),
                query.threads};
    }

    // Replaces the triangle indices of the hits by random indices, which may be out of range.
    void invent_hits(Random& random) {
        for (std::int32_t& index : triangle) index = random_int(random, -2, static_cast<int>(tri.size()));
    }

    // Composites discs at the vertices, with radii and densities that may be invalid, and returns the picture.
    // `composite` is the function to test, which is called with a tree, rays and a picture.
    template <typename Composite>
    Floats composite_discs(Random& random, float hostile, const Composite& composite) const {
        const std::size_t count = xyz.size() / 3;
        const Floats radius = random_floats(random, count, -0.1f, 1, hostile);
        const Floats density = random_floats(random, count, -0.1f, 2, hostile);
        const Floats colours = random_floats(random, 3 * count, 0, 1, 0);
        const Floats facing = random_floats(random, 3, -1, 1, hostile);
        Floats rgba(4 * query.count);
        const rays::Discs discs = {xyz.data(), radius.data(), density.data(), count};
        const rays::DiscTree tree = rays::build_discs(discs, query.threads);
        const float* const plane = random_int(random, 0, 1) == 1 ? facing.data() : nullptr;
        const int most = random_int(random, 1, rays::kMaxDiscLayers);
        const rays::DiscPicture picture = {colours.data(), plane, most, rgba.data()};
        composite(rays::DiscTreeView{tree.nodes.data(), tree.nodes.size(), tree.blocks.data(), tree.magnitude}, query,
                  picture);
        return rgba;
    }

    static rays::TreeView view(const rays::Tree& tree) {
        return {tree.nodes.data(), tree.nodes.size(), tree.blocks.data(), tree.blocks.size(), tree.magnitude};
    }
};

}  // namespace fourd::tests
