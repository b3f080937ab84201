// Inner loops over batches of kRun consecutive points. Each SIMD lane computes one point, so each MLP weight is
// broadcast to all lanes, and values of different lanes are never added.
#include <cmath>
#include <cstring>

#include "blend/cpu/loops.h"

namespace fourd::blend::FOURD_SIMD {
namespace {

#if defined(__AVX512F__)
constexpr int kNative = 16;
#elif defined(__AVX__)
constexpr int kNative = 8;
#else
constexpr int kNative = 4;
#endif
constexpr int kParts = kRun / kNative;
constexpr int kSums = kLanes / kNative;

#if defined(__GNUC__)

typedef float Vector __attribute__((vector_size(4 * kNative)));

inline Vector broadcast(float x) { return x - Vector{}; }

// Returns the lanes of `value` where x is positive, and 0 in the other lanes.
inline Vector where_positive(const Vector& x, const Vector& value) { return x > 0.0f ? value : Vector{}; }

#else

struct Vector {
    float lane[kNative];

    Vector& operator+=(const Vector& other) {
        for (int i = 0; i < kNative; ++i) lane[i] += other.lane[i];
        return *this;
    }
    Vector& operator*=(const Vector& other) {
        for (int i = 0; i < kNative; ++i) lane[i] *= other.lane[i];
        return *this;
    }
};

inline Vector broadcast(float x) {
    Vector out;
    for (float& lane : out.lane) lane = x;
    return out;
}
inline Vector operator*(Vector a, const Vector& b) { return a *= b; }
inline Vector operator*(float a, const Vector& b) { return broadcast(a) * b; }
inline Vector operator/(Vector a, float b) {
    for (float& lane : a.lane) lane /= b;
    return a;
}
inline Vector operator-(float a, Vector b) {
    for (float& lane : b.lane) lane = a - lane;
    return b;
}

inline Vector where_positive(const Vector& x, const Vector& value) {
    Vector out;
    for (int i = 0; i < kNative; ++i) out.lane[i] = x.lane[i] > 0.0f ? value.lane[i] : 0.0f;
    return out;
}

#endif

// One value for each point of a batch. The last batch is padded with zeros.
struct RunValues {
    Vector part[kParts];
};

inline void load_run(const float* from, int count, RunValues* to) {
    if (count == kRun) {
        std::memcpy(to, from, sizeof *to);
        return;
    }
    std::memset(to, 0, sizeof *to);
    std::memcpy(to, from, count * sizeof(float));
}

inline void store_run(const RunValues& from, int count, float* to) { std::memcpy(to, &from, count * sizeof(float)); }

// Transposes the rows of `count` points, so that out[h] has value h of every point.
inline void load_transposed(const float* from, int width, int count, RunValues* out) {
    if (count < kRun) std::memset(out, 0, width * sizeof(RunValues));
    float* to = reinterpret_cast<float*>(out);
    for (int i = 0; i < count; ++i) {
        for (int h = 0; h < width; ++h) to[h * kRun + i] = from[static_cast<std::size_t>(i) * width + h];
    }
}

inline void store_transposed(const RunValues* from, int width, int count, float* to) {
    const float* rows = reinterpret_cast<const float*>(from);
    for (int i = 0; i < count; ++i) {
        for (int h = 0; h < width; ++h) to[static_cast<std::size_t>(i) * width + h] = rows[h * kRun + i];
    }
}

// Returns the offset of the sample of channel c in one view, for the point with index `first`.
inline std::size_t sample_at(const Mlp& mlp, const Inputs& inputs, std::size_t view, int c, std::size_t first) {
    return (view * mlp.channels + c) * inputs.count + first;
}

// Returns the values of hidden unit h for every point of a batch, before the ReLU.
inline RunValues hidden_values(const Mlp& mlp, const RunValues& point, const RunValues* samples, int h) {
    RunValues sum = point;
    for (int c = 0; c < mlp.channels; ++c) {
        const float weight = mlp.weight[static_cast<std::size_t>(c) * mlp.hidden + h];
        for (int p = 0; p < kParts; ++p) sum.part[p] += weight * samples[c].part[p];
    }
    return sum;
}

void forward(const Mlp& mlp, const Inputs& inputs, std::size_t first, int count, float* logits) {
    RunValues point[kMaxHidden], samples[kMaxChannels];
    load_transposed(inputs.point + first * mlp.hidden, mlp.hidden, count, point);
    for (std::size_t view = 0; view < inputs.views; ++view) {
        for (int c = 0; c < mlp.channels; ++c) {
            load_run(inputs.samples + sample_at(mlp, inputs, view, c, first), count, samples + c);
        }
        RunValues raw;
        for (int p = 0; p < kParts; ++p) raw.part[p] = broadcast(mlp.bias);
        for (int h = 0; h < mlp.hidden; ++h) {
            const RunValues hidden = hidden_values(mlp, point[h], samples, h);
            for (int p = 0; p < kParts; ++p) {
                raw.part[p] += mlp.out[h] * where_positive(hidden.part[p], hidden.part[p]);
            }
        }
        float values[kRun];
        std::memcpy(values, &raw, sizeof values);
        for (int i = 0; i < count; ++i) values[i] = mlp.range * tanhf(values[i] / mlp.range);
        std::memcpy(logits + view * inputs.count + first, values, count * sizeof(float));
    }
}

// Computes the product a * b for each point, and adds the products to kLanes partial sums.
inline void add_products(const RunValues& a, const RunValues& b, float* sum) {
    for (int first = 0; first < kSums; ++first) {
        Vector total;
        std::memcpy(&total, sum + first * kNative, sizeof total);
        for (int p = first; p < kParts; p += kSums) total += a.part[p] * b.part[p];
        std::memcpy(sum + first * kNative, &total, sizeof total);
    }
}

void backward(const Mlp& mlp, const Inputs& inputs, std::size_t first, int count, const float* logits,
              const float* gradient, const Gradients& out, const Sums& sums) {
    RunValues point[kMaxHidden], to_point[kMaxHidden], samples[kMaxChannels], back[kMaxHidden];
    load_transposed(inputs.point + first * mlp.hidden, mlp.hidden, count, point);
    std::memset(to_point, 0, mlp.hidden * sizeof(RunValues));
    RunValues ones;
    for (int p = 0; p < kParts; ++p) ones.part[p] = broadcast(1.0f);
    for (std::size_t view = 0; view < inputs.views; ++view) {
        for (int c = 0; c < mlp.channels; ++c) {
            load_run(inputs.samples + sample_at(mlp, inputs, view, c, first), count, samples + c);
        }
        RunValues logit, raw;
        load_run(logits + view * inputs.count + first, count, &logit);
        load_run(gradient + view * inputs.count + first, count, &raw);
        for (int p = 0; p < kParts; ++p) {
            const Vector ratio = logit.part[p] / mlp.range;
            raw.part[p] *= 1.0f - ratio * ratio;
        }
        add_products(raw, ones, sums.bias);
        for (int h = 0; h < mlp.hidden; ++h) {
            RunValues hidden = hidden_values(mlp, point[h], samples, h);
            for (int p = 0; p < kParts; ++p) {
                back[h].part[p] = where_positive(hidden.part[p], mlp.out[h] * raw.part[p]);
                to_point[h].part[p] += back[h].part[p];
                hidden.part[p] = where_positive(hidden.part[p], hidden.part[p]);
            }
            add_products(raw, hidden, sums.out + h * kLanes);
        }
        for (int c = 0; c < mlp.channels; ++c) {
            const std::size_t row = static_cast<std::size_t>(c) * mlp.hidden;
            RunValues to_sample = {};
            for (int h = 0; h < mlp.hidden; ++h) {
                const float weight = mlp.weight[row + h];
                for (int p = 0; p < kParts; ++p) to_sample.part[p] += weight * back[h].part[p];
            }
            for (int h = 0; h < mlp.hidden; ++h) {
                add_products(back[h], samples[c], sums.weight + (row + h) * kLanes);
            }
            store_run(to_sample, count, out.samples + sample_at(mlp, inputs, view, c, first));
        }
    }
    store_transposed(to_point, mlp.hidden, count, out.point + first * mlp.hidden);
}

}  // namespace

const Loops loops = {forward, backward};

}  // namespace fourd::blend::FOURD_SIMD
