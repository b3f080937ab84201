// Checks the arguments of the image encoder, for the CPU and a GPU.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>

#include "binding/require.h"
#include "encoder/encoder.h"

namespace fourd {

template <typename Device>
struct EncoderArguments {
    template <typename Number, std::size_t Axes>
    using Array = nanobind::ndarray<Number, nanobind::ndim<Axes>, nanobind::c_contig, Device>;
    template <typename Number>
    using AnyArray = nanobind::ndarray<Number, nanobind::c_contig, Device>;
    using Images = nanobind::ndarray<const float, nanobind::shape<-1, 3, -1, -1>, nanobind::c_contig, Device>;

    static constexpr std::size_t kLongestSide = 1 << 16, kMaxImages = 1 << 12;

    // Checks the sizes and the shape (images, rows, columns, channels) of the features.
    template <typename Features>
    static encoder::Sizes sizes_of(const Images& images, int stride, const Features& features) {
        const std::size_t count = images.shape(0), height = images.shape(2), width = images.shape(3);
        require(stride == 1 || stride == 2, "stride: expected 1 or 2");
        const std::size_t step = 4 * static_cast<std::size_t>(stride), channels = features.shape(3);
        require(count <= kMaxImages, "images: expected at most 4096");
        require(height >= step && width >= step && height % step == 0 && width % step == 0 &&
                    height <= kLongestSide && width <= kLongestSide,
                "images: expected sides that are multiples of 4 * stride, at most 65536");
        require(channels >= 1 && channels <= encoder::kMaxFeatures, "features: expected 1 to 64 channels");
        require(features.shape(0) == count && features.shape(1) == height / stride &&
                    features.shape(2) == width / stride,
                "features: expected shape (images, height / stride, width / stride, channels)");
        return {static_cast<int>(count), static_cast<int>(height), static_cast<int>(width), stride,
                static_cast<int>(channels)};
    }

    // Checks the size of an image for which memory is needed.
    static encoder::Sizes sizes_of(int images, int height, int width, int stride) {
        const int side = static_cast<int>(kLongestSide);
        require(stride == 1 || stride == 2, "stride: expected 1 or 2");
        require(images >= 0 && images <= static_cast<int>(kMaxImages), "images: expected at most 4096");
        require(height >= 1 && width >= 1 && height <= side && width <= side, "height, width: expected 1 to 65536");
        return {images, height, width, stride, 1};
    }
};

}  // namespace fourd
