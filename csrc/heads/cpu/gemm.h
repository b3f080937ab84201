// Products of small matrices for one block of points. A dispatched file (common/dispatch.h) includes this file inside
// its namespace.

#include "vectors/native.inc"

constexpr int kTileRows = kNative == 16 ? 8 : 4;
static_assert(kPad % kNative == 0, "rows are whole vectors");

// A matrix whose element (row, column) is at[row * row_step + column * column_step].
struct Strided {
    const float* at;
    std::size_t row_step, column_step;
};

// Adds the product a * b to Rows rows and Columns vectors of c. The sums stay in registers.
template <int Rows, int Columns>
FOURD_INLINE void add_tile(const Strided& a, const float* b, std::size_t b_step, int depth, float* c,
                           std::size_t c_step) {
    Vector sum[Rows][Columns];
FOURD_UNROLL
    for (int r = 0; r < Rows; ++r) {
FOURD_UNROLL
        for (int v = 0; v < Columns; ++v) std::memcpy(&sum[r][v], c + r * c_step + v * kNative, sizeof(Vector));
    }
    const float* left = a.at;
    for (int k = 0; k < depth; ++k, left += a.column_step, b += b_step) {
        Vector right[Columns];
FOURD_UNROLL
        for (int v = 0; v < Columns; ++v) std::memcpy(&right[v], b + v * kNative, sizeof(Vector));
FOURD_UNROLL
        for (int r = 0; r < Rows; ++r) {
            const float value = left[r * a.row_step];
FOURD_UNROLL
            for (int v = 0; v < Columns; ++v) multiply_add(value, right[v], sum[r][v]);
        }
    }
FOURD_UNROLL
    for (int r = 0; r < Rows; ++r) {
FOURD_UNROLL
        for (int v = 0; v < Columns; ++v) std::memcpy(c + r * c_step + v * kNative, &sum[r][v], sizeof(Vector));
    }
}

template <int Columns>
inline void add_panel(Strided a, int rows, const float* b, std::size_t b_step, int depth, float* c,
                      std::size_t c_step) {
    int r = 0;
    for (; r + kTileRows <= rows; r += kTileRows, a.at += kTileRows * a.row_step, c += kTileRows * c_step) {
        add_tile<kTileRows, Columns>(a, b, b_step, depth, c, c_step);
    }
    for (; r < rows; ++r, a.at += a.row_step, c += c_step) add_tile<1, Columns>(a, b, b_step, depth, c, c_step);
}

// Adds the product of a (rows, depth) and b (depth, columns) to c (rows, columns). `columns` is a multiple of kPad, and
// the rows of b and c begin b_step and c_step floats apart. A panel of b with two vectors per row stays in the L1 cache
// while all rows of a are processed.
inline void add_product(const Strided& a, int rows, const float* b, std::size_t b_step, int depth, float* c,
                        std::size_t c_step, int columns) {
    int u = 0;
    for (; u + 2 * kNative <= columns; u += 2 * kNative) add_panel<2>(a, rows, b + u, b_step, depth, c + u, c_step);
    for (; u < columns; u += kNative) add_panel<1>(a, rows, b + u, b_step, depth, c + u, c_step);
}
