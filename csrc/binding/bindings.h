// Each kernel's folder adds its functions to the module.
#pragma once

#include <nanobind/nanobind.h>

namespace fourd {

void bind_blend(nanobind::module_& module);
void bind_hashgrid(nanobind::module_& module);
void bind_planes(nanobind::module_& module);
void bind_play(nanobind::module_& module);
void bind_points(nanobind::module_& module);
void bind_shade(nanobind::module_& module);
void bind_similarity(nanobind::module_& module);
void bind_sources(nanobind::module_& module);

}  // namespace fourd
