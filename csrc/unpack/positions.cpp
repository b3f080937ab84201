#include "unpack/unpack.h"

namespace fourd::unpack {
namespace {

// Gathers every third bit of a Morton code, from bit 0 on, into the low 21 bits.
std::uint64_t gather_bits(std::uint64_t code) {
    code &= 0x1249249249249249;
    code = (code | code >> 2) & 0x10c30c30c30c30c3;
    code = (code | code >> 4) & 0x100f00f00f00f00f;
    code = (code | code >> 8) & 0x001f0000ff0000ff;
    code = (code | code >> 16) & 0x001f00000000ffff;
    return (code | code >> 32) & 0x00000000001fffff;
}

}  // namespace

void positions(const Positions& from, float* out) {
    std::uint64_t code = 0;
    for (std::size_t i = 0; i < from.points; ++i) {
        std::uint64_t step = 0;
        for (int plane = 0; plane < from.code_bytes; ++plane) {
            step |= static_cast<std::uint64_t>(from.planes[static_cast<std::size_t>(plane) * from.points + i])
                    << (8 * plane);
        }
        code += step;
        for (int axis = 0; axis < 3; ++axis) {
            const double cell = static_cast<double>(gather_bits(code >> axis));
            out[3 * i + static_cast<std::size_t>(axis)] = static_cast<float>(from.lower[axis] + cell * from.step);
        }
    }
}

}  // namespace fourd::unpack
