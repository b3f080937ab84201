// Computes the picture in runs of kRun pixels of a row. Every step is a loop over the arrays of a run, which compilers
// vectorise.
#include "stylize/cpu/loops.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "common/inline.h"
#include "common/stream.h"

namespace fourd::stylize::FOURD_SIMD {
namespace {

#include "stylize/cpu/taps.inc"
#include "stylize/cpu/lines.inc"

struct Colours {
    float red[kRun], green[kRun], blue[kRun];
};

inline float mix(float a, float b, float share) { return a + share * (b - a); }

// Looks up colours in the shade table. `tone` in [0, 1] selects the column, and `detail` in [0, 1] selects the row.
inline void look_up(const Style& style, const float* tone, const float* detail, Colours& out) {
    const std::uint32_t* table = style.table;
    if (style.rows == 1) {
        for (int i = 0; i < kRun; ++i) {
            const std::uint32_t at = table[static_cast<int>(tone[i] * 255.0f + 0.5f)];
            out.red[i] = channel(at, 0);
            out.green[i] = channel(at, 8);
            out.blue[i] = channel(at, 16);
        }
        return;
    }
    const float last = static_cast<float>(style.rows - 1);
    for (int i = 0; i < kRun; ++i) {
        const float row = detail[i] * last;
        int first = static_cast<int>(row);
        first = first < style.rows - 2 ? first : style.rows - 2;
        const float share = row - static_cast<float>(first);
        const int at = kTones * first + static_cast<int>(tone[i] * 255.0f + 0.5f);
        const std::uint32_t a = table[at], b = table[at + kTones];
        out.red[i] = mix(channel(a, 0), channel(b, 0), share);
        out.green[i] = mix(channel(a, 8), channel(b, 8), share);
        out.blue[i] = mix(channel(a, 16), channel(b, 16), share);
    }
}

// For each pixel: the tone (1 + N.L) / 2, the cosine N.V (`facing`), and the detail from 0 to 1, which selects the row
// of the shade table. N is the unit normal, and L and V are the unit vectors towards the light and towards the camera.
struct Shape {
    float tone[kRun], facing[kRun], detail[kRun];
};

inline void measure_tone(const Taps& centre, const Numbers& n, float* tone) {
    for (int i = 0; i < kRun; ++i) {
        const int c = kMargin + i;
        const float light = centre.x[c] * n.light[0] + centre.y[c] * n.light[1] + centre.z[c] * n.light[2];
        tone[i] = clamp01(0.5f + 0.5f * light / larger(centre.coverage[c], 1.0f / 255.0f));
    }
}

inline void measure_facing(const Taps& centre, const Numbers& n, int row, int first, float* facing) {
    const float y = static_cast<float>(row) + 0.5f;
    for (int i = 0; i < kRun; ++i) {
        const int c = kMargin + i;
        const float x = static_cast<float>(first + i) + 0.5f;
        const float across = n.ray[0] * x + n.ray[1] * y + n.ray[2], along = n.ray[3] * x + n.ray[4] * y + n.ray[5];
        const float length = std::sqrt(across * across + along * along + 1.0f);
        const float away = centre.x[c] * across + centre.y[c] * along + centre.z[c];
        facing[i] = clamp01(-away / (length * larger(centre.coverage[c], 1.0f / 255.0f)));
    }
}

inline void measure_depth_detail(const Taps& centre, const Style& style, float* detail) {
    const Numbers& n = style.numbers;
    const bool is_focus = style.detail == Detail::focus;
    for (int i = 0; i < kRun; ++i) {
        const float depth = n.detail_offset + n.detail_per_depth / larger(centre.depth[kMargin + i], 1e-20f);
        detail[i] = clamp01(is_focus ? size_of(depth) : depth);
    }
}

// Computes the members of Shape that the style needs. The other members are 0.
inline void measure(const Taps& centre, const Style& style, int row, int first, Shape& out) {
    const Numbers& n = style.numbers;
    const bool has_rows = style.rows > 1, by_facing = style.detail == Detail::facing;
    std::memset(&out, 0, sizeof out);
    measure_tone(centre, n, out.tone);
    if (n.angle_strength > 0.0f || (has_rows && by_facing)) measure_facing(centre, n, row, first, out.facing);
    if (has_rows && by_facing) std::memcpy(out.detail, out.facing, sizeof out.detail);
    if (has_rows && !by_facing) measure_depth_detail(centre, style, out.detail);
}

// Returns 1 if `position` is a whole number, 0 if it is halfway between two whole numbers, and linearly interpolated
// values for all other positions.
inline float wave(float position) {
    const float whole = static_cast<float>(static_cast<int>(position)), part = position - whole;
    return size_of(2.0f * part - 1.0f);
}

// The hatching parameters of a style. Reciprocals are computed once per run of pixels, because divisions are slow.
struct Hatching {
    float width, spacing, per_spacing, levels[2], per_level[2];
};

inline Hatching hatching_of(const Numbers& n) {
    Hatching out{n.hatch_width, n.hatch_spacing, 1.0f / n.hatch_spacing, {}, {}};
    for (int layer = 0; layer < 2; ++layer) {
        out.levels[layer] = n.hatch_levels[layer];
        out.per_level[layer] = 1.0f / larger(n.hatch_levels[layer], 1e-6f);
    }
    return out;
}

// Returns the fraction of a pixel that two layers of hatching cover with ink. Hatch lines become wider as `light`
// decreases.
inline float ink_at(const Hatching& hatching, float x, float y, float light) {
    float ink = 0.0f;
    for (int layer = 0; layer < 2; ++layer) {
        const float turned = layer == 0 ? x + 0.5f * y : 16384.0f + x - 0.7f * y;
        const float distance = 1.0f - wave(turned * hatching.per_spacing);
        const float width = hatching.width * clamp01((hatching.levels[layer] - light) * hatching.per_level[layer]);
        ink = larger(ink, clamp01((width - distance) * hatching.spacing * 0.5f + 0.5f) * (width > 0.0f ? 1.0f : 0.0f));
    }
    return ink;
}

inline std::uint32_t byte_of(float value) { return static_cast<std::uint32_t>(static_cast<int>(clamp01(value) * 255.0f + 0.5f)); }

inline void paint(const std::uint32_t* albedo, const Taps& centre, const Shape& shape, const Style& style, int row,
                  int first, std::uint32_t* out) {
    const Numbers& n = style.numbers;
    const float y = static_cast<float>(row) + 0.5f;
    Colours table;
    look_up(style, shape.tone, shape.detail, table);
    const float per_softness = 0.5f / n.angle_softness;
    const bool has_hatching = n.hatch_width > 0.0f;
    const Hatching hatching = hatching_of(n);
    float inks[kRun];
    std::memset(inks, 0, sizeof inks);
    for (int i = 0; has_hatching && i < kRun; ++i) {
        const float x = static_cast<float>(first + i) + 0.5f;
        const float inverse = 1.0f / larger(channel(albedo[i], 24), 1.0f / 255.0f);
        const float grey = 0.299f * clamp01(channel(albedo[i], 0) * inverse) +
                           0.587f * clamp01(channel(albedo[i], 8) * inverse) +
                           0.114f * clamp01(channel(albedo[i], 16) * inverse);
        inks[i] = ink_at(hatching, x, y, std::sqrt(grey * shape.tone[i]));
    }
    for (int i = 0; i < kRun; ++i) {
        const float alpha = channel(albedo[i], 24), coverage = alpha > 0.0f ? centre.coverage[kMargin + i] : 0.0f;
        const float inverse = 1.0f / larger(alpha, 1.0f / 255.0f);
        const float edge = clamp01(0.5f + (n.angle_threshold - shape.facing[i]) * per_softness);
        const float dark = n.angle_strength * edge;
        const float shades[3] = {table.red[i], table.green[i], table.blue[i]};
        std::uint32_t packed = byte_of(coverage) << 24;
        for (int c = 0; c < 3; ++c) {
            const float own = clamp01(channel(albedo[i], 8 * c) * inverse);
            float value = clamp01(shades[c] * (n.table_alone + n.table_times_albedo * own) + n.albedo_alone * own);
            value = mix(value, n.angle_colour[c], dark);
            value = mix(value, n.hatch_colour[c], inks[i]);
            packed |= byte_of(mix(n.paper[c], value, coverage)) << (8 * c);
        }
        out[i] = packed;
    }
}

inline std::uint32_t paper_of(const Numbers& n) {
    return byte_of(n.paper[0]) | byte_of(n.paper[1]) << 8 | byte_of(n.paper[2]) << 16;
}

// Shades a run of a row, including the hatching. The lines at abrupt changes of depth or normal are drawn later.
// rows[1] has the taps (samples of the surface) in this row.
inline void shade_run(const Surface& surface, const Style& style, const Taps* const* rows, int row, int first, int count,
                      std::uint32_t* picture) {
    Shape shape;
    measure(*rows[1], style, row, first, shape);
    std::uint32_t albedo[kRun] = {};
    const std::size_t pixel = static_cast<std::size_t>(row) * surface.width + first;
    copy_run(surface.albedo + 4 * pixel, count, albedo);
    paint(albedo, *rows[1], shape, style, row, first, picture);
}

#include "stylize/cpu/specks.inc"

// Shades rows [begin, end) of the column of runs that starts at pixel `first` of each row.
void shade_column(const Surface& surface, const Style& style, int first, int begin, int end, const LineImage& lines,
                  std::uint8_t* out) {
    Column column(surface, style.thickness, first, begin);
    const std::uint32_t paper = paper_of(style.numbers);
    const int count = surface.width - first < kRun ? surface.width - first : kRun, reach = style.thickness;
    int last_seen = begin - 3 * kMargin;  // The last row with a surface.
    int checked = begin - reach - kGap;   // The next row to check for a surface.
    for (int row = begin; row < end; ++row) {
        for (; checked <= row + reach; ++checked) {
            if (has_surface(surface, checked, first)) last_seen = checked;
        }
        const std::size_t pixel = static_cast<std::size_t>(row) * surface.width + first;
        if (last_seen < row - reach) {
            stream_words(0, static_cast<std::size_t>(count), lines.state + pixel);
            stream_words(paper, static_cast<std::size_t>(count), out + 4 * pixel);
            continue;
        }
        column.read(row - reach, row + reach);
        const Taps* rows[3] = {column.taps(row - reach), column.taps(row), column.taps(row + reach)};
        find_lines(surface, rows, style, row, first, count, lines);
        std::uint32_t picture[kRun];
        shade_run(surface, style, rows, row, first, count, picture);
        copy_run(picture, count, out + 4 * pixel);
    }
}

void shade_rows(const Surface& surface, const Style& style, int begin, int end, const LineImage& lines,
                std::uint8_t* out) {
    for (int first = 0; first < surface.width; first += kRun) {
        shade_column(surface, style, first, begin, end, lines, out);
    }
    finish_streams();
}

}  // namespace

const Loops loops = {shade_rows, draw_lines};

}  // namespace fourd::stylize::FOURD_SIMD
