// Arguments that several bindings take, checked and converted.
#pragma once

#include <nanobind/ndarray.h>

#include <cstdint>
#include <string>
#include <vector>

#include "points/points.h"
#include "shade/shade.h"

namespace fourd {

// Throws std::invalid_argument, a ValueError in Python, unless the condition holds.
void require(bool condition, const char* message);

// camera: K, R (row-major) and T, 21 numbers. Throws std::invalid_argument.
points::Settings points_settings(const std::vector<double>& camera, std::size_t width, std::size_t height, int layers,
                                 double near, double transmittance_min, int threads, const std::string& simd);

// Of the views to blend, and of a camera's centre; both in the host's memory.
using ChosenArray = nanobind::ndarray<const std::int32_t, nanobind::ndim<1>, nanobind::c_contig, nanobind::device::cpu>;
using CentreArray = nanobind::ndarray<const double, nanobind::shape<3>, nanobind::c_contig, nanobind::device::cpu>;

shade::Settings shade_settings(const ChosenArray& chosen, std::size_t views, const CentreArray& centre, float sh_range,
                               float sh_base, int threads, const std::string& simd);

}  // namespace fourd
