// Makes Python objects from the input bytes of a fuzzer, as arguments for bound functions.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <climits>
#include <cstdint>
#include <new>
#include <string>
#include <vector>

#include "fuzz/bytes.h"
#include "fuzz/rules.h"

namespace fourd::fuzz {

namespace nb = nanobind;

// Maximum number of elements of one array, so that a call takes only milliseconds.
constexpr std::size_t kMaxElements = 1 << 16;

// Index of hatch_spacing in stylize::Numbers. hatch_spacing must be at least 1; all other numbers of a style may be
// smaller.
constexpr std::size_t kHatchSpacing = 28;

// Thrown if the sizes of a call are too large.
struct TooLarge {};

inline nb::dlpack::dtype dtype_named(const std::string& name) {
    using Code = nb::dlpack::dtype_code;
    const auto bits = static_cast<std::uint8_t>(std::stoi(name.substr(name.find_first_of("0123456789"))));
    const Code code = name[0] == 'f' ? Code::Float : name[0] == 'u' ? Code::UInt : Code::Int;
    return {static_cast<std::uint8_t>(code), bits, 1};
}

// Makes the arguments of one call. The array with the index `perturbed` gets a wrong size along one axis. If
// `perturbed` is -1, no array gets a wrong size.
class ArgumentMaker {
  public:
    ArgumentMaker(Bytes& bytes, Sizes& sizes, const Rules& rules, int perturbed)
        : bytes_(bytes), sizes_(sizes), rules_(rules), perturbed_(perturbed) {}

    nb::object make(const Parameter& parameter) {
        const auto found = rules_.find(parameter.name);
        const Rule rule = found == rules_.end() ? Rule{} : found->second;
        if (parameter.is_optional && bytes_.one_in(4)) return nb::none();
        switch (parameter.kind) {
            case Kind::array: return array(parameter, rule, 0);
            case Kind::arrays: return list(rule, [&](std::size_t index) { return array(parameter, rule, index); });
            case Kind::number: return nb::float_(number());
            case Kind::numbers: return numbers(parameter, rule);
            case Kind::integer: return nb::int_(rule.axes.empty() ? integer() : long(sizes_.evaluate(rule.axes[0], 0)));
            case Kind::integers: return list(rule, [&](std::size_t) { return nb::int_(integer()); });
            case Kind::flag: return nb::bool_(bytes_.one_in(2));
            case Kind::text: return text(parameter.name);
            case Kind::object: break;
        }
        return nb::none();
    }

  private:
    template <typename Make>
    nb::object list(const Rule& rule, Make make_item) {
        std::size_t count = rule.length.empty() ? bytes_.byte() % 5 : sizes_.evaluate(rule.length, 0);
        if (bytes_.byte() == 255) ++count;
        if (count > 2048) throw TooLarge();
        nb::list out;
        for (std::size_t index = 0; index < count; ++index) out.append(make_item(index));
        return out;
    }

    // Makes a list of numbers. Camera matrices (K, R and T) are usually valid, because with an invalid camera, the
    // points are culled and most of the code does not run.
    nb::object numbers(const Parameter& parameter, const Rule& rule) {
        const bool is_camera = parameter.name == "camera" || parameter.name == "cameras";
        const bool is_softness = parameter.name == "softness";
        const unsigned hostile = bytes_.byte() % 4;
        Values values(bytes_.pair());
        const double focal = values.uniform(1, 60), depth = values.uniform(-1, 4);
        const double camera[21] = {focal, 0, 20, 0, focal, 15, 0, 0, 1, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, depth};
        const double soft[7] = {values.uniform(0, 2) < 1 ? 0.0 : 1.0, 1e-4, 1e-2, 1e-3, 0.1, 10, 1e-3};
        return list(rule, [&](std::size_t index) {
            double value = is_camera ? camera[index % 21] : is_softness ? soft[index % 7] : values.uniform(-1, 1);
            if (hostile == 3 && values.bits() % 8 == 0) value = values.hostile();
            return nb::float_(value);
        });
    }

    nb::object array(const Parameter& parameter, const Rule& rule, std::size_t index) {
        std::vector<std::size_t> shape;
        std::size_t count = 1, free = 0;
        const bool is_perturbed = arrays_++ == perturbed_;
        const std::size_t chosen = is_perturbed ? bytes_.byte() : 0;
        for (std::size_t axis = 0; axis < parameter.shape.size(); ++axis) {
            std::size_t side = static_cast<std::size_t>(parameter.shape[axis]);
            if (parameter.shape[axis] < 0) {
                side = free < rule.axes.size() ? sizes_.evaluate(rule.axes[free], index) : bytes_.size();
                if (is_perturbed && free == chosen % 5) side = chosen % 2 && side > 0 ? side - 1 : side + chosen / 10;
                ++free;
            }
            shape.push_back(side);
            count *= side;
            if (count > kMaxElements) throw TooLarge();
        }
        return filled(parameter, rule, shape, count);
    }

    // The memory ends at the last element, so that AddressSanitizer detects accesses beyond the end of the array.
    nb::object filled(const Parameter& parameter, const Rule& rule, const std::vector<std::size_t>& shape,
                      std::size_t count) {
        const nb::dlpack::dtype type = dtype_named(parameter.dtype);
        const std::size_t bytes = count * type.bits / 8;
        auto* const data = new std::uint8_t[bytes];
        nb::capsule owner(data, [](void* memory) noexcept { delete[] static_cast<std::uint8_t*>(memory); });
        fill(parameter, rule, data, count, bytes);
        return nb::cast(nb::ndarray<>(data, shape.size(), shape.data(), owner, nullptr, type));
    }

    void fill(const Parameter& parameter, const Rule& rule, std::uint8_t* data, std::size_t count, std::size_t bytes) {
        const unsigned mode = bytes_.byte() % 8;
        if (mode == 7) return bytes_.repeat(data, bytes);
        if (mode == 6) return static_cast<void>(std::memset(data, 0, bytes));
        Values values(bytes_.pair());
        const long limit = rule.limit.empty() ? 9 : static_cast<long>(sizes_.evaluate(rule.limit, 0));
        for (std::size_t i = 0; i < count; ++i) {
            if (parameter.dtype == "float32") {
                const bool is_style = parameter.name == "numbers" && mode < 4;
                const double value = is_style ? values.uniform(0, 1) + (i == kHatchSpacing) : real(values, mode);
                reinterpret_cast<float*>(data)[i] = static_cast<float>(value);
            } else if (parameter.dtype == "float64") {
                reinterpret_cast<double*>(data)[i] = real(values, mode);
            } else if (parameter.dtype == "int32") {
                reinterpret_cast<std::int32_t*>(data)[i] = whole(values, mode, limit);
            } else if (parameter.dtype == "uint16") {
                const std::uint64_t bits = values.bits();
                reinterpret_cast<std::uint16_t*>(data)[i] = static_cast<std::uint16_t>(mode < 4 ? bits % 0x3c01 : bits);
            } else {
                for (std::size_t k = 0; k < bytes / count; ++k) {
                    data[i * (bytes / count) + k] = static_cast<std::uint8_t>(values.bits());
                }
            }
        }
    }

    static double real(Values& values, unsigned mode) {
        if (mode >= 4 && values.bits() % 8 == 0) return values.hostile();
        return mode == 0 ? values.uniform(0, 1) : mode == 1 ? values.uniform(0, 2) : values.uniform(-1, 1);
    }

    static std::int32_t whole(Values& values, unsigned mode, long limit) {
        const std::uint64_t bits = values.bits();
        if (mode < 5) return limit > 0 ? static_cast<std::int32_t>(bits % static_cast<std::uint64_t>(limit)) : 0;
        if (bits % 8 > 0) return static_cast<std::int32_t>(bits / 8 % static_cast<std::uint64_t>(limit + 3)) - 1;
        return bits % 16 > 0 ? INT_MAX - static_cast<std::int32_t>(bits / 16 % 3) : INT_MIN;
    }

    double number() {
        constexpr double kNumbers[] = {0, 0.01, 0.1, 0.25, 0.5, 0.9, 1, 2, 5, 100, 1e-30, 1e30, -1, -0.5};
        const unsigned choice = bytes_.byte();
        return choice < 224 ? kNumbers[choice % 14] : Values(choice).hostile();
    }

    long integer() {
        constexpr long kNumbers[] = {-1, 100, 256, 300, 65536, 1 << 20, INT_MAX, INT_MIN};
        const unsigned choice = bytes_.byte();
        return choice < 240 ? choice % 12 : kNumbers[choice % 8];
    }

    nb::object text(const std::string& name) {
        static const std::map<std::string, std::vector<const char*>> kTexts = {
            {"simd", {"baseline", "avx2", "avx512", "sse9"}},
            {"filter", {"nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear", "cubic"}},
            {"boundary", {"wrap", "clamp", "zero", "cube", "mirror"}},
        };
        const auto found = kTexts.find(name);
        const unsigned choice = bytes_.byte();
        return nb::str(found == kTexts.end() ? "" : found->second[choice % found->second.size()]);
    }

    Bytes& bytes_;
    Sizes& sizes_;
    const Rules& rules_;
    int perturbed_, arrays_ = 0;
};

}  // namespace fourd::fuzz
