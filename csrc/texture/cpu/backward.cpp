// The backward pass on the CPU. The texels of each level are divided into bands of consecutive texels, whose gradient
// sums stay in the L2 cache. A first pass over the pixels writes the gradients of uv, uv_da and bias, and lists for
// each band the pixels that read its texels. A second pass adds the gradients of the listed pixels to the sums of the
// band, in the order of the pixels. One worker processes the list of a band. If the list is long, it is divided into
// parts with separate sums, which different workers can process. The sums of the parts are then added in order. The
// second pass therefore needs no locks, and results do not depend on the number of threads.
#include <cstring>

#include "common/buffer.h"
#include "common/pages.h"
#include "common/team.h"
#include "texture/cpu/tasks.h"

namespace fourd::texture {
namespace {

// A band has about 16 rows of texels, so that few pixels read texels of two bands. A band also fits into the L2 cache.
constexpr std::size_t kRowsPerBand = 16, kMinBandTexels = 1 << 12, kMaxBandFloats = 1 << 18;
// An entry records that a pixel reads texels of a band (loops.h). If a band has more than kMaxEntriesPerPart entries,
// the entries are divided into parts, which are summed separately and in parallel.
constexpr std::size_t kMaxEntriesPerPart = 1 << 15;

Bands bands_of(const Shape& shape) {
    Bands out{};
    for (int level = 0; level < shape.level_count; ++level) {
        const std::size_t wanted = std::max(kMinBandTexels, kRowsPerBand * side_at(shape.width, level));
        while ((std::size_t{1} << out.shift[level]) < wanted) ++out.shift[level];
        while (out.shift[level] > 4 && (stride_of(shape.channels) << out.shift[level]) > kMaxBandFloats) {
            --out.shift[level];
        }
        out.first[level] = out.count;
        out.count += static_cast<int>(((shape.texels(level) - 1) >> out.shift[level]) + 1);
    }
    return out;
}

// For each task (range of pixels), its entries (loops.h), sorted by band.
class EntryTable {
  public:
    EntryTable(const Bands& bands, std::size_t tasks, int workers)
        : bands_(bands.count), entries_(tasks), starts_(tasks * (bands_ + 1)), lists_(workers) {}

    // Returns an empty list, in the memory of the worker, to which the entries of one task can be appended.
    EntryList list(int worker) {
        List& list = lists_[worker];
        list.bands.require(kMaxEntries);
        list.entries.require(kMaxEntries);
        return {list.bands.data(), list.entries.data(), 0};
    }

    // Stores the entries of a task, sorted by band. Entries of the same band stay in order.
    void store(std::size_t task, const EntryList& list) {
        std::uint32_t* start = starts_.data() + task * (bands_ + 1);
        std::memset(start, 0, (bands_ + 1) * sizeof *start);
        for (std::size_t i = 0; i < list.count; ++i) ++start[list.bands[i] + 1];
        for (std::size_t band = 0; band < bands_; ++band) start[band + 1] += start[band];
        entries_[task] = Buffer<Entry>(list.count);
        for (std::size_t i = 0; i < list.count; ++i) entries_[task][start[list.bands[i]]++] = list.entries[i];
        // The loop has advanced the start of each band to the start of the next band, so all starts are moved back by
        // one band.
        std::memmove(start + 1, start, bands_ * sizeof *start);
        start[0] = 0;
    }

    std::size_t count(std::size_t task, std::size_t band) const { return start(task, band + 1) - start(task, band); }
    const Entry* entries(std::size_t task, std::size_t band) const {
        return entries_[task].data() + start(task, band);
    }

  private:
    struct List {
        Buffer<std::uint32_t> bands;
        Buffer<Entry> entries;
    };

    std::size_t start(std::size_t task, std::size_t band) const { return starts_[task * (bands_ + 1) + band]; }

    std::size_t bands_;
    std::vector<Buffer<Entry>> entries_;
    Buffer<std::uint32_t> starts_;
    std::vector<List> lists_;
};

// The entries of a band that come from the tasks [first_task, last_task).
struct Part {
    std::size_t item;
    int level;
    std::size_t band;
    std::size_t first_task, last_task;
    int number, count;  // Index of this part among the parts of the band, and number of parts of the band.
    std::size_t sums;   // Index of this part's sums in the array of partial sums, if the band has several parts.
};

// Computes the gradient of the texture.
class Scatter {
  public:
    Scatter(const Query& query, const std::vector<Task>& tasks, const Bands& bands, const EntryTable& table)
        : query_(query), tasks_(tasks), bands_(bands), table_(table) {
        const Shape& shape = query.texture.shape;
        const std::size_t tasks_per_item = tasks.size() / shape.items;
        for (std::size_t item = 0; item < shape.items; ++item) {
            for (int level = 0; level < shape.level_count; ++level) {
                const std::size_t first = bands.first[level];
                const std::size_t last = level + 1 < shape.level_count ? bands.first[level + 1] : bands.count;
                for (std::size_t band = first; band < last; ++band) {
                    add_parts(item, level, band, item * tasks_per_item, (item + 1) * tasks_per_item);
                }
            }
        }
    }

    void run(Team& team, const Loops& loops, const float* gradient, const float* levels, float* const* out) {
        sums_ = Buffer<float>(sums_count_ * sums_size());
        std::vector<Buffer<float>> scratch(team.size());
        for (int level = 0; level < query_.texture.shape.level_count; ++level) {
            const Shape& shape = query_.texture.shape;
            prefer_huge_pages(out[level], shape.items * shape.floats(level) * sizeof(float));
        }
        team.run(static_cast<int>(parts_.size()), [&](int index, int worker) {
            const Part& part = parts_[index];
            scratch[worker].require(sums_size());
            float* sums = part.count > 1 ? sums_.data() + part.sums * sums_size() : scratch[worker].data();
            const BandSums band = sums_of(part, sums);
            std::memset(sums, 0, floats(band) * sizeof(float));
            for (std::size_t task = part.first_task; task < part.last_task; ++task) {
                loops.scatter(query_, tasks_[task], table_.entries(task, part.band), table_.count(task, part.band),
                              gradient, levels, band);
            }
            if (part.count == 1) write(part, band, out);
        });
        team.run(static_cast<int>(parts_.size()), [&](int index, int) {
            if (parts_[index].count > 1 && parts_[index].number == 0) add_up(index, out);
        });
    }

  private:
    // Returns the number of floats in the sums of the largest band.
    std::size_t sums_size() const {
        std::size_t largest = 0;
        for (int level = 0; level < query_.texture.shape.level_count; ++level) {
            const std::size_t texels =
                std::min(std::size_t{1} << bands_.shift[level], query_.texture.shape.texels(level));
            largest = std::max(largest, texels);
        }
        return largest * stride_of(query_.texture.shape.channels);
    }

    void add_parts(std::size_t item, int level, std::size_t band, std::size_t first_task, std::size_t last_task) {
        const std::size_t first_part = parts_.size();
        std::size_t entries = 0, begin = first_task;
        for (std::size_t task = first_task; task < last_task; ++task) {
            entries += table_.count(task, band);
            if (entries < kMaxEntriesPerPart) continue;
            parts_.push_back({item, level, band, begin, task + 1, 0, 0, 0});
            begin = task + 1;
            entries = 0;
        }
        if (entries > 0 || parts_.size() == first_part) {
            parts_.push_back({item, level, band, begin, last_task, 0, 0, 0});
        }
        const int count = static_cast<int>(parts_.size() - first_part);
        for (int number = 0; number < count; ++number) {
            Part& part = parts_[first_part + number];
            part.number = number;
            part.count = count;
            if (count > 1) part.sums = sums_count_++;
        }
    }

    BandSums sums_of(const Part& part, float* sums) const {
        const int shift = bands_.shift[part.level];
        const std::size_t begin = (part.band - bands_.first[part.level]) << shift;
        const std::size_t end = std::min(begin + (std::size_t{1} << shift), query_.texture.shape.texels(part.level));
        return {part.level, static_cast<int>(begin), static_cast<int>(end), sums};
    }

    std::size_t floats(const BandSums& band) const {
        return static_cast<std::size_t>(band.end - band.begin) * stride_of(query_.texture.shape.channels);
    }

    // Adds the sums of all parts of a band, in the order of the parts.
    void add_up(int first, float* const* out) {
        const BandSums band = sums_of(parts_[first], sums_.data() + parts_[first].sums * sums_size());
        for (int number = 1; number < parts_[first].count; ++number) {
            const float* from = sums_.data() + parts_[first + number].sums * sums_size();
            for (std::size_t i = 0; i < floats(band); ++i) band.sums[i] += from[i];
        }
        write(parts_[first], band, out);
    }

    void write(const Part& part, const BandSums& band, float* const* out) const {
        const Shape& shape = query_.texture.shape;
        const std::size_t channels = shape.channels, stride = stride_of(shape.channels);
        float* to = out[part.level] + part.item * shape.floats(part.level) + band.begin * channels;
        const std::size_t texels = band.end - band.begin;
        if (stride == channels) {
            std::memcpy(to, band.sums, texels * channels * sizeof(float));
            return;
        }
        for (std::size_t i = 0; i < texels; ++i) std::memcpy(to + 3 * i, band.sums + 4 * i, 3 * sizeof(float));
    }

    const Query& query_;
    const std::vector<Task>& tasks_;
    const Bands& bands_;
    const EntryTable& table_;
    std::vector<Part> parts_;
    std::size_t sums_count_ = 0;
    Buffer<float> sums_;
};

// Uses huge pages for the gradients that have at least one float per pixel: those of uv, uv_da and bias.
void prefer_huge_pages_for(const Query& query, const Gradients& out) {
    const std::size_t bytes = query.pictures * query.pixels * sizeof(float);
    const std::size_t coordinates = static_cast<std::size_t>(query.coordinates());
    if (out.uv) prefer_huge_pages(out.uv, coordinates * bytes);
    if (out.uv_da) prefer_huge_pages(out.uv_da, 2 * coordinates * bytes);
    if (out.bias) prefer_huge_pages(out.bias, bytes);
}

}  // namespace

void sample_backward(const Query& query, const float* gradient, bool is_chain, const Gradients& out) {
    const Loops& loops = select_loops(query.simd);
    const Shape& shape = query.texture.shape;
    const bool to_texture = out.levels[0] != nullptr;
    const std::vector<Task> tasks = tasks_of(query);
    const Bands bands = bands_of(shape);
    Team team(query.threads);
    prefer_huge_pages_for(query, out);
    EntryTable table(bands, to_texture ? tasks.size() : 0, team.size());
    Buffer<float> levels_of_pixels;
    if (to_texture && uses_mips(query.filter)) levels_of_pixels = Buffer<float>(query.pictures * query.pixels);
    float* const levels = levels_of_pixels.data();
    team.run(static_cast<int>(tasks.size()), [&](int task, int worker) {
        EntryList list{};
        if (to_texture) list = table.list(worker);
        loops.pixel_gradients(query, tasks[task], gradient, out, levels, bands, to_texture ? &list : nullptr);
        if (to_texture) table.store(task, list);
    });
    if (!to_texture) return;
    Scatter(query, tasks, bands, table).run(team, loops, gradient, levels, out.levels);
    if (!is_chain) return;
    for (int level = shape.level_count - 1; level > 0; --level) {
        for_halved_rows(shape, level, team, [&](const HalvedRows& rows) {
            loops.halve_backward(out.levels[level] + rows.coarse, rows.fine_width, rows.halves_rows, shape.channels,
                                 rows.count, out.levels[level - 1] + rows.fine);
        });
    }
}

}  // namespace fourd::texture
