// Products of small matrices for one block of points. A dispatched file (common/dispatch.h) includes this file inside
// its namespace.

#include "vectors/native.inc"

constexpr int kTileRows = kNative == 16 ? 8 : 4;
static_assert(kPad % kNative == 0, "rows are whole vectors");

// A matrix whose element (row, column) is at[row * row_step + column * column_step].
struct Strided {
    const float* at;
    std::size_t row_step, column_step;

    const float* row(int index) const { return at + index * row_step; }
};

// A matrix whose rows begin `step` floats apart. With the step 0, all rows are the same.
struct Rows {
    const float* at;
    std::size_t step;
};

constexpr Rows kZeros{nullptr, 0};

// What happens to a product before it is written: nothing, ReLU, or the gradient of ReLU, which sets the elements to 0
// where the elements of another matrix are not positive.
enum class Finish { none, rectify, mask };

// A factor (depth, columns) whose rows are whole vectors, and the matrices that are read for the result.
struct Product {
    const float* b;
    std::size_t b_step;
    int depth;
    Rows start;  // The matrix to which the product is added, or kZeros.
    Rows mask;   // For Finish::mask.
};

// Computes R rows and C vectors of a product. The sums stay in registers.
template <int R, int C>
FOURD_INLINE void tile_sums(const Strided& a, const Product& p, int row, int column, Vector (&sum)[R][C]) {
FOURD_UNROLL
    for (int r = 0; r < R; ++r) {
FOURD_UNROLL
        for (int v = 0; v < C; ++v) {
            sum[r][v] = Vector{};
            if (p.start.at) read(p.start.at + (row + r) * p.start.step + column + v * kNative, sum[r][v]);
        }
    }
    const float *left = a.row(row), *b = p.b + column;
    for (int k = 0; k < p.depth; ++k, left += a.column_step, b += p.b_step) {
        Vector right[C];
FOURD_UNROLL
        for (int v = 0; v < C; ++v) read(b + v * kNative, right[v]);
FOURD_UNROLL
        for (int r = 0; r < R; ++r) {
            const float value = left[r * a.row_step];
FOURD_UNROLL
            for (int v = 0; v < C; ++v) multiply_add(value, right[v], sum[r][v]);
        }
    }
}

template <int R, int C, Finish finish>
FOURD_INLINE void product_tile(const Strided& a, const Product& p, int row, int column, float* to, std::size_t step) {
    Vector sum[R][C];
    tile_sums(a, p, row, column, sum);
FOURD_UNROLL
    for (int r = 0; r < R; ++r) {
FOURD_UNROLL
        for (int v = 0; v < C; ++v) {
            const int at = column + v * kNative;
            Vector mask = sum[r][v];
            if (finish == Finish::mask) read(p.mask.at + (row + r) * p.mask.step + at, mask);
            if (finish != Finish::none) keep_positive(mask, sum[r][v]);
            write(sum[r][v], to + (row + r) * step + at);
        }
    }
}

// The rows that do not fill a tile are computed in smaller tiles, because a single row has too few sums to hide the
// latency of additions.
template <int C, Finish finish>
inline void product_panel(const Strided& a, int rows, const Product& p, int column, float* to, std::size_t step) {
    int r = 0;
    for (; r + kTileRows <= rows; r += kTileRows) product_tile<kTileRows, C, finish>(a, p, r, column, to, step);
    if (kTileRows > 4 && r + 4 <= rows) {
        product_tile<4, C, finish>(a, p, r, column, to, step);
        r += 4;
    }
    if (r + 2 <= rows) {
        product_tile<2, C, finish>(a, p, r, column, to, step);
        r += 2;
    }
    if (r < rows) product_tile<1, C, finish>(a, p, r, column, to, step);
}

// Writes start + a * b to `to` (rows, columns), whose rows begin `step` floats apart. `columns` is a multiple of kPad.
// A panel of b with two vectors per row stays in the L1 cache while all rows of a are processed.
template <Finish finish = Finish::none>
inline void product(const Strided& a, int rows, const Product& p, float* to, std::size_t step, int columns) {
    int u = 0;
    for (; u + 2 * kNative <= columns; u += 2 * kNative) product_panel<2, finish>(a, rows, p, u, to, step);
    for (; u < columns; u += kNative) product_panel<1, finish>(a, rows, p, u, to, step);
}

// Adds a * b to `to`.
inline void add_product(const Strided& a, int rows, const float* b, std::size_t b_step, int depth, float* to,
                        std::size_t step, int columns) {
    product(a, rows, {b, b_step, depth, {to, step}, kZeros}, to, step, columns);
}
