// Random hash grids with levels of 1 to 2^20 cells per side, and random points inside and outside the grid.
#pragma once

#include "hashgrid/hashgrid.h"
#include "tests/random_inputs.h"

namespace fourd::tests {

struct HashGridInputs {
    Floats coordinates, table;
    std::vector<hashgrid::Level> levels;
    hashgrid::Query query{};
    Floats out, to_table, to_coordinates;  // Results.

    HashGridInputs(Random& random, int count, float hostile) {
        const int features =
            random_int(random, 0, 1) ? 1 << random_int(random, 0, 3) : random_int(random, 1, hashgrid::kMaxFeatures);
        const int log2_entries = random_int(random, 4, 12);
        std::size_t entries = 0;
        for (int l = random_int(random, 1, 6); l > 0; --l) {
            const int resolution =
                random_int(random, 0, 3) ? random_int(random, 1, 40) : 1 << random_int(random, 0, 20);
            levels.push_back(hashgrid::level_of(resolution, log2_entries, entries));
            entries = levels.back().first + levels.back().entries;
        }
        const std::size_t points = static_cast<std::size_t>(count);
        coordinates = random_floats(random, 3 * points, -0.1f, 1.1f, hostile);
        table = random_floats(random, entries * features, -1, 1, 0);
        query = {table.data(),  entries,
                 levels.data(), static_cast<int>(levels.size()),
                 features,      coordinates.data(),
                 points,        random_int(random, 1, 4),
                 Simd::baseline};
        // Results are initialised with NaN, so that tests detect results that the kernels do not write.
        out.assign(points * levels.size() * features, kNan);
        to_table.assign(random_int(random, 0, 4) ? table.size() : 0, kNan);
        to_coordinates.assign(random_int(random, 0, 2) ? coordinates.size() : 0, kNan);
    }

    float* grad_table() { return to_table.empty() ? nullptr : to_table.data(); }
    float* grad_coordinates() { return to_coordinates.empty() ? nullptr : to_coordinates.data(); }

    void expect_finite_results(unsigned seed) const {
        expect_finite(out, "encoding", seed);
        expect_finite(to_table, "gradient of the table", seed);
        expect_finite(to_coordinates, "gradient of coordinates", seed);
    }
};

}  // namespace fourd::tests
