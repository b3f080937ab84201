// Loops over the points of one level, written so that compilers vectorise them.
#include "hashgrid/cpu/loops.h"

#include <cstdint>
#include <cstring>

#include "common/inline.h"

namespace fourd::hashgrid::FOURD_SIMD {
namespace {

constexpr int kRun = 16;  // Number of points per batch. While one batch is processed, the next batch is prefetched.

// A SIMD vector of `Width` floats.
template <int Width>
struct Vector;
template <>
struct Vector<1> {
    typedef float Type;
};
#if defined(__GNUC__)
template <>
struct Vector<2> {
    typedef float Type __attribute__((vector_size(8)));
};
template <>
struct Vector<4> {
    typedef float Type __attribute__((vector_size(16)));
};
constexpr int width_of(int features) { return features % 4 == 0 ? 4 : features % 2 == 0 ? 2 : 1; }
#else
constexpr int width_of(int) { return 1; }
#endif

// The features of a table entry, or the gradient with respect to these features.
template <int Features>
struct Entry {
    static constexpr int kWidth = width_of(Features), kParts = Features / kWidth;
    typename Vector<kWidth>::Type parts[kParts];
    static_assert(sizeof parts == Features * sizeof(float), "a vector's attribute was lost");
};

template <int Features>
FOURD_INLINE void load(const float* from, Entry<Features>* to) {
    constexpr int kWidth = Entry<Features>::kWidth;
    for (int part = 0; part < Entry<Features>::kParts; ++part) {
        std::memcpy(&to->parts[part], from + kWidth * part, kWidth * sizeof(float));
    }
}

template <int Features>
FOURD_INLINE void store(const Entry<Features>& from, float* to) {
    constexpr int kWidth = Entry<Features>::kWidth;
    for (int part = 0; part < Entry<Features>::kParts; ++part) {
        std::memcpy(to + kWidth * part, &from.parts[part], kWidth * sizeof(float));
    }
}

template <int Features>
FOURD_INLINE void add(float weight, const Entry<Features>& from, Entry<Features>* to) {
    for (int part = 0; part < Entry<Features>::kParts; ++part) to->parts[part] += weight * from.parts[part];
}

// The grid cells that contain the points of a batch. The members are those of Cell (hashgrid/maths.h), with the point
// as the last index: entry[corner][point], weight[edge][point] for the four edges of the cell that are parallel to x,
// and fraction[point].
struct Cells {
    std::uint32_t entry[kCorners][kRun];
    float weight[kCorners / 2][kRun];
    float fraction[kRun];
};

// The coordinates of the points of a batch, indexed by axis, then by point. Elements after the last point are 0.
struct Coordinates {
    float at[3][kRun];
};

FOURD_INLINE void gather(const float* coordinates, int count, Coordinates* out) {
    for (int i = 0; i < count; ++i) {
        for (int axis = 0; axis < 3; ++axis) out->at[axis][i] = coordinates[3 * i + axis];
    }
    for (int i = count; i < kRun; ++i) {
        for (int axis = 0; axis < 3; ++axis) out->at[axis][i] = 0.0f;
    }
}

template <bool Hashed>
FOURD_INLINE void find_cells_as(const Level& level, const Coordinates& from, Cells* out) {
    Level known = level;
    known.hashed = Hashed;
    for (int i = 0; i < kRun; ++i) {
        const Cell cell = cell_of(known, interpolate_axis(level, from.at[0][i]), interpolate_axis(level, from.at[1][i]),
                                  interpolate_axis(level, from.at[2][i]));
        for (int corner = 0; corner < kCorners; ++corner) out->entry[corner][i] = cell.entry[corner];
        for (int edge = 0; edge < kCorners / 2; ++edge) out->weight[edge][i] = cell.weight[edge];
        out->fraction[i] = cell.fraction;
    }
}

// Finds the cells of `count` points, at most kRun. This function is not forced inline: its code is long, and all
// callers can share one copy.
void find_cells(const Level& level, const float* coordinates, int count, Cells* out) {
    Coordinates run;
    gather(coordinates, count, &run);
    if (level.hashed) {
        find_cells_as<true>(level, run, out);
    } else {
        find_cells_as<false>(level, run, out);
    }
}

template <int Features>
FOURD_INLINE std::size_t entry_of(const Cells& cells, int corner, int i) {
    return std::size_t{cells.entry[corner][i]} * Features;
}

// Prefetches the eight table entries around point i.
template <int Features, int Write>
FOURD_INLINE void prefetch_entries(const Cells& cells, int i, const float* values) {
    for (int corner = 0; corner < kCorners; ++corner) {
        if (Write) {
            prefetch_for_write(values + entry_of<Features>(cells, corner, i));
        } else {
            prefetch(values + entry_of<Features>(cells, corner, i));
        }
    }
}

// Interpolates the table entries at the corners of a point's cell trilinearly.
template <int Features>
FOURD_INLINE void interpolate(const Cells& cells, int i, const float* values, float* out) {
    Entry<Features> lower = {}, upper = {}, entry;
    for (int edge = 0; edge < kCorners / 2; ++edge) {
        load(values + entry_of<Features>(cells, 2 * edge, i), &entry);
        add(cells.weight[edge][i], entry, &lower);
        load(values + entry_of<Features>(cells, 2 * edge + 1, i), &entry);
        add(cells.weight[edge][i], entry, &upper);
    }
    add(-1.0f, lower, &upper);
    add(cells.fraction[i], upper, &lower);
    store(lower, out);
}

// Multiplies the gradient of a point by the interpolation weights, and adds the products to the gradients of the table
// entries at the corners of the point's cell.
template <int Features>
FOURD_INLINE void scatter_sample(const Cells& cells, int i, const float* gradient, float* values) {
    Entry<Features> lower, upper = {}, entry;
    load(gradient, &lower);
    add(cells.fraction[i], lower, &upper);
    add(-1.0f, upper, &lower);
    for (int corner = 0; corner < kCorners; ++corner) {
        float* const at = values + entry_of<Features>(cells, corner, i);
        load(at, &entry);
        add(cells.weight[corner / 2][i], corner % 2 ? upper : lower, &entry);
        store(entry, at);
    }
}

FOURD_INLINE int run_length(std::size_t begin, std::size_t end) {
    return end - begin < kRun ? static_cast<int>(end - begin) : kRun;
}

// Calls use(cells, i, point) for each point in [begin, end). During the calls for one batch, prefetch_entries(cells, i,
// point) is called for the points of the next batch.
template <typename Fetch, typename Use>
FOURD_INLINE void for_cells(const Level& level, const float* coordinates, std::size_t begin, std::size_t end,
                            const Fetch& prefetch_entries, const Use& use) {
    Cells cells[2];
    int count = run_length(begin, end);
    find_cells(level, coordinates + 3 * begin, count, &cells[0]);
    for (int turn = 0; count > 0; turn = 1 - turn) {
        const std::size_t ahead = begin + count;
        const int later = run_length(ahead, end);
        if (later > 0) find_cells(level, coordinates + 3 * ahead, later, &cells[1 - turn]);
        for (int i = 0; i < later; ++i) {
            prefetch_entries(cells[1 - turn], i, ahead + i);
            use(cells[turn], i, begin + i);
        }
        for (int i = later; i < count; ++i) use(cells[turn], i, begin + i);
        begin = ahead;
        count = later;
    }
}

// Describes where the arrays of a query contain the data of one level.
template <int Features>
struct LevelView {
    const Level& level;
    std::size_t width;   // Number of floats per row of the encoding.
    std::size_t column;  // Offset of the level's first feature in a row.
    std::size_t values;  // Offset of the level's entries in the table.

    LevelView(const Query& query, int l)
        : level(query.levels[l]),
          width(static_cast<std::size_t>(query.level_count) * Features),
          column(static_cast<std::size_t>(l) * Features),
          values(query.levels[l].first * Features) {}
};

// Writes the features of one level into the encoding of the points in [begin, end).
template <int Features>
FOURD_INLINE void encode_level(const Query& query, int l, std::size_t begin, std::size_t end, float* out) {
    const LevelView<Features> at(query, l);
    const float* const values = query.table + at.values;
    for_cells(
        at.level, query.coordinates, begin, end,
        [&](const Cells& cells, int i, std::size_t)
            FOURD_INLINE_LAMBDA { prefetch_entries<Features, 0>(cells, i, values); },
        [&](const Cells& cells, int i, std::size_t point)
            FOURD_INLINE_LAMBDA { interpolate<Features>(cells, i, values, out + at.width * point + at.column); });
}

// Adds the contributions of all points to the gradient of the table entries of one level.
template <int Features>
FOURD_INLINE void scatter_level(const Query& query, int l, const float* gradient, float* grad_table) {
    const LevelView<Features> at(query, l);
    const float* const from = gradient + at.column;
    float* const values = grad_table + at.values;
    for_cells(
        at.level, query.coordinates, 0, query.count,
        [&](const Cells& cells, int i, std::size_t point) FOURD_INLINE_LAMBDA {
            prefetch_entries<Features, 1>(cells, i, values);
            prefetch(from + at.width * point);
        },
        [&](const Cells& cells, int i, std::size_t point)
            FOURD_INLINE_LAMBDA { scatter_sample<Features>(cells, i, from + at.width * point, values); });
}

// Adds the contribution of one level to the coordinate gradients of the points in [begin, end).
template <int Features>
FOURD_INLINE void coordinate_gradient_level(const Query& query, int l, std::size_t begin, std::size_t end,
                                            const float* gradient, float* grad_coordinates) {
    const LevelView<Features> at(query, l);
    const float* const values = query.table + at.values;
    for_cells(
        at.level, query.coordinates, begin, end,
        [&](const Cells& cells, int i, std::size_t)
            FOURD_INLINE_LAMBDA { prefetch_entries<Features, 0>(cells, i, values); },
        [&](const Cells& cells, int i, std::size_t point) FOURD_INLINE_LAMBDA {
            const float* const from = gradient + at.width * point + at.column;
            float grad_corner[kCorners];  // For each corner, the dot product of its entry and the point's gradient.
            for (int corner = 0; corner < kCorners; ++corner) {
                const float* const entry = values + entry_of<Features>(cells, corner, i);
                grad_corner[corner] = 0.0f;
                for (int f = 0; f < Features; ++f) grad_corner[corner] += from[f] * entry[f];
            }
            add_slopes(at.level, query.coordinates + 3 * point, grad_corner, grad_coordinates + 3 * point);
        });
}

template <int Features>
void encode(const Query& query, int level, std::size_t begin, std::size_t end, float* out) {
    encode_level<Features>(query, level, begin, end, out);
}

template <int Features>
void scatter(const Query& query, int level, const float* gradient, float* out) {
    scatter_level<Features>(query, level, gradient, out);
}

template <int Features>
void coordinate_gradient(const Query& query, int level, std::size_t begin, std::size_t end, const float* gradient,
                         float* out) {
    coordinate_gradient_level<Features>(query, level, begin, end, gradient, out);
}

template <int Features>
constexpr LevelLoops kLevelLoops = {encode<Features>, scatter<Features>, coordinate_gradient<Features>};

}  // namespace

static_assert(kMaxFeatures == 8, "one entry for each number of features");
const Loops loops = {{kLevelLoops<1>, kLevelLoops<2>, kLevelLoops<3>, kLevelLoops<4>, kLevelLoops<5>, kLevelLoops<6>,
                      kLevelLoops<7>, kLevelLoops<8>}};

}  // namespace fourd::hashgrid::FOURD_SIMD
