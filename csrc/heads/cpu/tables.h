// The parts of the first layers that come from tables (heads/cpu/lines.h), for one block of points. heads/cpu/loops.cpp
// includes this file inside its namespace.

// The knots before the points of a block along each axis, and how far the points are on the way to the next knots.
struct Places {
    int knot[3][kBlock];
    float fraction[3][kBlock];
};

inline void locate(const Job& job, std::size_t first, int count, Places* out) {
    const float* coordinates = job.inputs->time_planes.coordinates + 4 * first;
    for (int axis = 0; axis < 3; ++axis) {
        const AxisTable& table = job.tables[axis];
        for (int i = 0; i < count; ++i) {
            float x = coordinates[4 * i + axis];
            x = x > -1.0f ? x : -1.0f;  // Also for NaN.
            x = x < 1.0f ? x : 1.0f;
            const int bucket = static_cast<int>((x + 1.0f) * (0.5f * kBuckets));
            int knot = table.starts[bucket < kBuckets ? bucket : kBuckets - 1];
            while (knot + 2 < table.knots && table.positions[knot + 1] <= x) ++knot;
            const float fraction = (x - table.positions[knot]) * table.scales[knot];
            out->knot[axis][i] = knot;
            out->fraction[axis][i] = fraction > 0.0f ? fraction : 0.0f;
        }
    }
}

// Writes the biases of the first layers, plus what the tables contribute.
inline void interpolate_tables(const Job& job, const Places& places, int count, float* to, std::size_t step) {
    const int width = job.sizes->first_stride();
    for (int i = 0; i < count; ++i, to += step) {
        const float* rows[3];
        float high[3], low[3];
        for (int axis = 0; axis < 3; ++axis) {
            rows[axis] = job.tables[axis].values + static_cast<std::size_t>(places.knot[axis][i]) * width;
            high[axis] = places.fraction[axis][i];
            low[axis] = 1.0f - high[axis];
        }
        for (int u = 0; u < width; u += kNative) {
            Vector sum, value;
            read(job.packed->first_bias + u, sum);
FOURD_UNROLL
            for (int axis = 0; axis < 3; ++axis) {
                read(rows[axis] + u, value);
                multiply_add(low[axis], value, sum);
                read(rows[axis] + width + u, value);
                multiply_add(high[axis], value, sum);
            }
            write(sum, to + u);
        }
    }
}

// Adds the gradient of the first layers to that of the tables.
inline void scatter_to_tables(const Job& job, const Places& places, int count, const float* gradient, float* tables) {
    const int width = job.sizes->first_stride();
    for (int i = 0; i < count; ++i, gradient += width) {
        float* rows[3];
        float high[3], low[3];
        for (int axis = 0; axis < 3; ++axis) {
            rows[axis] = tables + (job.tables[axis].first + places.knot[axis][i]) * width;
            high[axis] = places.fraction[axis][i];
            low[axis] = 1.0f - high[axis];
        }
        for (int u = 0; u < width; u += kNative) {
            Vector from, sum;
            read(gradient + u, from);
FOURD_UNROLL
            for (int axis = 0; axis < 3; ++axis) {
                read(rows[axis] + u, sum);
                multiply_add(low[axis], from, sum);
                write(sum, rows[axis] + u);
                read(rows[axis] + width + u, sum);
                multiply_add(high[axis], from, sum);
                write(sum, rows[axis] + width + u);
            }
        }
    }
}
