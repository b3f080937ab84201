// Checks and converts the arguments of texture lookups, for the CPU and a GPU. fourd/rendering/triangles/textures.py
// checks the values of the arguments. This file checks the shapes of arrays, because a kernel would read past the end
// of an array that is too small.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "binding/require.h"
#include "texture/texture.h"

namespace fourd {

template <typename Device>
struct TextureArguments {
    template <typename Number, std::size_t Axes>
    using Array = nanobind::ndarray<Number, nanobind::ndim<Axes>, nanobind::c_contig, Device>;
    using Level = Array<const float, 5>;  // Shape (items, faces, height, width, channels).
    using LevelOut = Array<float, 5>;
    using Pixels = Array<const float, 3>;  // Shape (pictures, pixels, numbers).
    using PixelsOut = Array<float, 3>;
    using Bias = Array<const float, 2>;
    using BiasOut = Array<float, 2>;

    using Extents = std::array<std::size_t, 5>;

    static constexpr std::size_t kMaxTexels = 0x7fffffff;
    static constexpr std::size_t kMaxChannels = 1 << 12;

    texture::Query query{};

    TextureArguments(const std::vector<Level>& levels, const Pixels& uv, const std::optional<Pixels>& uv_da,
                     const std::optional<Bias>& bias, const std::string& filter, const std::string& boundary,
                     int threads, Simd simd) {
        query.filter = filter_named(filter);
        query.boundary = boundary_named(boundary);
        query.texture.shape = shape_of(extents_of(levels));
        for (std::size_t level = 0; level < levels.size(); ++level) query.texture.levels[level] = levels[level].data();
        const texture::Shape& shape = query.texture.shape;
        const std::size_t coordinates = query.coordinates();
        require(query.boundary == texture::Boundary::cube ? shape.faces == 6 && shape.height == shape.width
                                                          : shape.faces == 1,
                "levels: expected 6 square faces for a cube map, and 1 face for other textures");
        require(uv.shape(2) == coordinates, "uv: expected 2 coordinates, or 3 for a cube");
        query.pictures = uv.shape(0);
        query.pixels = uv.shape(1);
        require(shape.items == 1 || shape.items == query.pictures, "levels: expected one texture, or one texture per picture");
        require(!uv_da || matches(*uv_da, 2 * coordinates), "uv_da: unexpected shape");
        require(!bias || matches_bias(*bias), "bias: unexpected shape");
        query.uv = uv.data();
        query.uv_da = uv_da ? uv_da->data() : nullptr;
        query.bias = bias ? bias->data() : nullptr;
        query.threads = threads;
        query.simd = simd;
    }

    // Checks that the array `picture` has the shape (pictures, pixels, channels).
    template <typename Picture>
    void require_picture(const Picture& picture, const char* message) const {
        require(matches(picture, query.texture.shape.channels), message);
    }

    texture::Gradients gradients(const std::vector<LevelOut>& levels, const std::optional<PixelsOut>& uv,
                                 const std::optional<PixelsOut>& uv_da, const std::optional<BiasOut>& bias) const {
        const std::size_t coordinates = query.coordinates();
        texture::Gradients out{};
        if (!levels.empty()) {
            require_levels(query.texture.shape, extents_of(levels), "out_levels: expected the shapes of the levels");
        }
        for (std::size_t level = 0; level < levels.size(); ++level) out.levels[level] = levels[level].data();
        require(!uv || matches(*uv, coordinates), "out_uv: unexpected shape");
        require(!uv_da || (query.uv_da && matches(*uv_da, 2 * coordinates)), "out_uv_da: unexpected shape");
        require(!bias || (query.bias && matches_bias(*bias)), "out_bias: unexpected shape");
        out.uv = uv ? uv->data() : nullptr;
        out.uv_da = uv_da ? uv_da->data() : nullptr;
        out.bias = bias ? bias->data() : nullptr;
        return out;
    }

    template <typename Levels>
    static std::vector<Extents> extents_of(const Levels& levels) {
        std::vector<Extents> out;
        for (const auto& level : levels) {
            out.push_back({level.shape(0), level.shape(1), level.shape(2), level.shape(3), level.shape(4)});
        }
        return out;
    }

    // Checks the shapes of level 0 and of the mip levels that are built from level 0, and returns them as one Shape.
    static texture::Shape shape_of_chain(const Level& base, const std::vector<LevelOut>& mips) {
        std::vector<Extents> extents = extents_of(mips);
        extents.insert(extents.begin(), extents_of(std::vector<Level>{base})[0]);
        const texture::Shape out = shape_of(extents);
        require_chain(out);
        return out;
    }

    // The kernels that build mip levels average pairs of texels along each axis that has more than one texel. In every
    // level except the last, each side must therefore be even or 1.
    static void require_chain(const texture::Shape& shape) {
        for (int level = 0; level + 1 < shape.level_count; ++level) {
            for (const int side : {texture::side_at(shape.height, level), texture::side_at(shape.width, level)}) {
                require(side == 1 || side % 2 == 0, "levels: expected even sides in every level before the last");
            }
        }
    }

    // Checks the shapes of the levels of a texture, and returns them as one Shape.
    static texture::Shape shape_of(const std::vector<Extents>& levels) {
        require(!levels.empty() && levels.size() <= texture::kMaxLevels, "levels: expected 1 to 16 levels");
        const auto [items, faces, height, width, channels] = levels[0];
        require(items >= 1 && (faces == 1 || faces == 6), "levels: expected at least one texture, of 1 or 6 faces");
        require(height >= 1 && width >= 1 && height <= texture::kMaxSide && width <= texture::kMaxSide,
                "levels: expected sides from 1 to 2^15 texels");
        require(faces * height * width <= kMaxTexels, "levels: expected fewer than 2^31 texels per texture");
        require(channels >= 1 && channels <= kMaxChannels, "levels: expected 1 to 4096 channels");
        const texture::Shape out{items,
                                 static_cast<int>(faces),
                                 static_cast<int>(height),
                                 static_cast<int>(width),
                                 static_cast<int>(channels),
                                 static_cast<int>(levels.size())};
        require_levels(out, levels, "levels: expected each level to have half the sides of the level before");
        return out;
    }

  private:
    static void require_levels(const texture::Shape& shape, const std::vector<Extents>& levels, const char* message) {
        require(levels.size() == static_cast<std::size_t>(shape.level_count), message);
        for (int level = 0; level < shape.level_count; ++level) {
            const Extents expected{shape.items, static_cast<std::size_t>(shape.faces),
                                   static_cast<std::size_t>(texture::side_at(shape.height, level)),
                                   static_cast<std::size_t>(texture::side_at(shape.width, level)),
                                   static_cast<std::size_t>(shape.channels)};
            require(levels[level] == expected, message);
        }
    }

    template <typename Picture>
    bool matches(const Picture& picture, std::size_t numbers) const {
        return picture.shape(0) == query.pictures && picture.shape(1) == query.pixels && picture.shape(2) == numbers;
    }

    template <typename Picture>
    bool matches_bias(const Picture& picture) const {
        return picture.shape(0) == query.pictures && picture.shape(1) == query.pixels;
    }

    static texture::Filter filter_named(const std::string& name) {
        if (name == "nearest") return texture::Filter::nearest;
        if (name == "linear") return texture::Filter::linear;
        if (name == "linear-mipmap-nearest") return texture::Filter::linear_mipmap_nearest;
        require(name == "linear-mipmap-linear", "filter: unexpected name");
        return texture::Filter::linear_mipmap_linear;
    }

    static texture::Boundary boundary_named(const std::string& name) {
        if (name == "wrap") return texture::Boundary::wrap;
        if (name == "clamp") return texture::Boundary::clamp;
        if (name == "zero") return texture::Boundary::zero;
        require(name == "cube", "boundary: unexpected name");
        return texture::Boundary::cube;
    }
};

}  // namespace fourd
