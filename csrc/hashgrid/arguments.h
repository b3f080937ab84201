// Checks and converts the arguments of the hash grid, for the CPU and a GPU. fourd/rendering/ops/hashgrid/op.py checks the values
// of the arguments. This file checks the shapes of arrays, because a kernel would read past the end of an array that is
// too small.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <optional>
#include <vector>

#include "binding/require.h"
#include "hashgrid/hashgrid.h"

namespace fourd {

template <typename Device>
struct HashGridArguments {
    template <typename Number>
    using Rows = nanobind::ndarray<Number, nanobind::ndim<2>, nanobind::c_contig, Device>;
    template <typename Number>
    using Points = nanobind::ndarray<Number, nanobind::shape<-1, 3>, nanobind::c_contig, Device>;

    static constexpr int kFinest = 1 << 20;
    static constexpr int kMaxLog2Entries = 24;

    const Rows<const float>& table;
    std::vector<hashgrid::Level> levels;
    hashgrid::Query query;

    // resolutions[l] is the number of cells per side of level l.
    HashGridArguments(const Points<const float>& coordinates, const Rows<const float>& table_,
                      const std::vector<int>& resolutions, int log2_entries, int threads, Simd simd)
        : table(table_) {
        require(!resolutions.empty() && resolutions.size() <= hashgrid::kMaxLevels,
                "resolutions: expected 1 to 32 levels");
        require(log2_entries >= 1 && log2_entries <= kMaxLog2Entries, "log2_entries: expected 1 to 24");
        require(features() >= 1 && features() <= hashgrid::kMaxFeatures, "table: expected 1 to 8 features");
        std::size_t entries = 0;
        for (const int resolution : resolutions) {
            require(resolution >= 1 && resolution <= kFinest, "resolutions: expected 1 to 2^20 cells per side");
            levels.push_back(hashgrid::level_of(resolution, log2_entries, entries));
            entries = levels.back().first + levels.back().entries;
        }
        require(table.shape(0) == entries, "table: expected as many entries as the levels need");
        const int level_count = static_cast<int>(levels.size());
        query = {
            table.data(),         entries, levels.data(), level_count, static_cast<int>(features()), coordinates.data(),
            coordinates.shape(0), threads, simd};
    }

    std::size_t features() const { return table.shape(1); }

    // Checks that the array `rows` has the shape (points, levels x features).
    template <typename Array>
    void require_rows(const Array& rows, const char* message) const {
        require(rows.shape(0) == query.count && rows.shape(1) == levels.size() * features(), message);
    }

    float* table_target(const std::optional<Rows<float>>& out_table) const {
        require(!out_table || (out_table->shape(0) == table.shape(0) && out_table->shape(1) == table.shape(1)),
                "out_table: expected the table's shape");
        return out_table ? out_table->data() : nullptr;
    }

    float* coordinates_target(const std::optional<Points<float>>& out_coordinates) const {
        require(!out_coordinates || out_coordinates->shape(0) == query.count, "out_coordinates: unexpected shape");
        return out_coordinates ? out_coordinates->data() : nullptr;
    }
};

}  // namespace fourd
