// What is done with runs of points at one level, as plain loops that compilers turn into vectors.
#include "hashgrid/cpu/loops.h"

#include <cstdint>
#include <cstring>

#include "common/inline.h"

namespace fourd::hashgrid::FOURD_SIMD {
namespace {

constexpr int kRun = 16;  // points whose cells are found together, and fetched while those before are used

// So many floats that are added and multiplied together.
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

// The features of an entry, or of its gradient.
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

// A run's cells, by corner and edge.
struct Cells {
    std::uint32_t entry[kCorners][kRun];
    float weight[kCorners / 2][kRun];
    float share[kRun];
};

// A run's coordinates, by axis. Places after the last point hold zeros.
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
        const Cell cell = cell_of(known, between(level, from.at[0][i]), between(level, from.at[1][i]),
                                  between(level, from.at[2][i]));
        for (int corner = 0; corner < kCorners; ++corner) out->entry[corner][i] = cell.entry[corner];
        for (int edge = 0; edge < kCorners / 2; ++edge) out->weight[edge][i] = cell.weight[edge];
        out->share[i] = cell.share;
    }
}

// The cells of count points, at most kRun. Not inlined by force: it is most of what is compiled, and the same for all uses.
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

// Fetches the lines of point i's entries.
template <int Features, int Write>
FOURD_INLINE void fetch(const Cells& cells, int i, const float* values) {
    for (int corner = 0; corner < kCorners; ++corner) {
        __builtin_prefetch(values + entry_of<Features>(cells, corner, i), Write);
    }
}

// The weighted mean of the corners' entries.
template <int Features>
FOURD_INLINE void mix(const Cells& cells, int i, const float* values, float* out) {
    Entry<Features> near = {}, far = {}, entry;
    for (int edge = 0; edge < kCorners / 2; ++edge) {
        load(values + entry_of<Features>(cells, 2 * edge, i), &entry);
        add(cells.weight[edge][i], entry, &near);
        load(values + entry_of<Features>(cells, 2 * edge + 1, i), &entry);
        add(cells.weight[edge][i], entry, &far);
    }
    add(-1.0f, near, &far);
    add(cells.share[i], far, &near);
    store(near, out);
}

// Adds the corners' shares of a gradient to their entries.
template <int Features>
FOURD_INLINE void spread(const Cells& cells, int i, const float* gradient, float* values) {
    Entry<Features> near, far = {}, entry;
    load(gradient, &near);
    add(cells.share[i], near, &far);
    add(-1.0f, far, &near);
    for (int corner = 0; corner < kCorners; ++corner) {
        float* const at = values + entry_of<Features>(cells, corner, i);
        load(at, &entry);
        add(cells.weight[corner / 2][i], corner % 2 ? far : near, &entry);
        store(entry, at);
    }
}

FOURD_INLINE int run_length(std::size_t begin, std::size_t end) {
    return end - begin < kRun ? static_cast<int>(end - begin) : kRun;
}

// Calls use(cells, i, point) for the points from begin to end, and fetch(cells, i, point) for each a run before that.
template <typename Fetch, typename Use>
FOURD_INLINE void for_cells(const Level& level, const float* coordinates, std::size_t begin, std::size_t end,
                            const Fetch& fetch, const Use& use) {
    Cells cells[2];
    int count = run_length(begin, end);
    find_cells(level, coordinates + 3 * begin, count, &cells[0]);
    for (int turn = 0; count > 0; turn = 1 - turn) {
        const std::size_t ahead = begin + count;
        const int later = run_length(ahead, end);
        if (later > 0) find_cells(level, coordinates + 3 * ahead, later, &cells[1 - turn]);
        for (int i = 0; i < later; ++i) {
            fetch(cells[1 - turn], i, ahead + i);
            use(cells[turn], i, begin + i);
        }
        for (int i = later; i < count; ++i) use(cells[turn], i, begin + i);
        begin = ahead;
        count = later;
    }
}

// The parts of arrays that a level has to do with.
template <int Features>
struct At {
    const Level& level;
    std::size_t width;   // of a row of the encoding
    std::size_t column;  // where the level's features begin in it
    std::size_t values;  // where its entries begin in the table

    At(const Query& query, int l)
        : level(query.levels[l]),
          width(static_cast<std::size_t>(query.level_count) * Features),
          column(static_cast<std::size_t>(l) * Features),
          values(query.levels[l].first * Features) {}
};

// One level's part of the encoding of the points from begin to end.
template <int Features>
FOURD_INLINE void encode_level(const Query& query, int l, std::size_t begin, std::size_t end, float* out) {
    const At<Features> at(query, l);
    const float* const values = query.table + at.values;
    for_cells(
        at.level, query.coordinates, begin, end,
        [&](const Cells& cells, int i, std::size_t) FOURD_ALWAYS { fetch<Features, 0>(cells, i, values); },
        [&](const Cells& cells, int i, std::size_t point) FOURD_ALWAYS {
            mix<Features>(cells, i, values, out + at.width * point + at.column);
        });
}

// Adds what one level gets of all points' gradient to its entries.
template <int Features>
FOURD_INLINE void scatter_level(const Query& query, int l, const float* gradient, float* grad_table) {
    const At<Features> at(query, l);
    const float* const from = gradient + at.column;
    float* const values = grad_table + at.values;
    for_cells(
        at.level, query.coordinates, 0, query.count,
        [&](const Cells& cells, int i, std::size_t point) FOURD_ALWAYS {
            fetch<Features, 1>(cells, i, values);
            __builtin_prefetch(from + at.width * point);
        },
        [&](const Cells& cells, int i, std::size_t point) FOURD_ALWAYS {
            spread<Features>(cells, i, from + at.width * point, values);
        });
}

// Adds what one level finds of the gradient in the points from begin to end.
template <int Features>
FOURD_INLINE void move_level(const Query& query, int l, std::size_t begin, std::size_t end, const float* gradient,
                             float* grad_coordinates) {
    const At<Features> at(query, l);
    const float* const values = query.table + at.values;
    for_cells(
        at.level, query.coordinates, begin, end,
        [&](const Cells& cells, int i, std::size_t) FOURD_ALWAYS { fetch<Features, 0>(cells, i, values); },
        [&](const Cells& cells, int i, std::size_t point) FOURD_ALWAYS {
            const float* const from = gradient + at.width * point + at.column;
            float along[kCorners];  // the gradient's part in each corner's entry
            for (int corner = 0; corner < kCorners; ++corner) {
                const float* const entry = values + entry_of<Features>(cells, corner, i);
                along[corner] = 0.0f;
                for (int f = 0; f < Features; ++f) along[corner] += from[f] * entry[f];
            }
            add_slopes(at.level, query.coordinates + 3 * point, along, grad_coordinates + 3 * point);
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
void move(const Query& query, int level, std::size_t begin, std::size_t end, const float* gradient, float* out) {
    move_level<Features>(query, level, begin, end, gradient, out);
}

template <int Features>
constexpr LevelLoops kLevelLoops = {encode<Features>, scatter<Features>, move<Features>};

}  // namespace

static_assert(kMostFeatures == 8, "one entry for each number of features");
const Loops loops = {{kLevelLoops<1>, kLevelLoops<2>, kLevelLoops<3>, kLevelLoops<4>, kLevelLoops<5>, kLevelLoops<6>,
                      kLevelLoops<7>, kLevelLoops<8>}};

}  // namespace fourd::hashgrid::FOURD_SIMD
