// Visibility edges move with the vertices. This file computes the part of the gradient with respect to vertex positions
// that is due to this motion, for an image that is not antialiased. Callers check shapes. Indices of vertices and
// triangles that are out of range are ignored.
#pragma once

#include "antialias/antialias.h"

namespace fourd::edge_gradients {

// `gradient` is the gradient of the loss with respect to the colours. Writes the gradient with respect to all
// Mesh::positions to `positions`.
void edge_gradients(const antialias::Mesh& mesh, const antialias::Images& images, const antialias::Settings& settings,
                    const float* gradient, float* positions);

}  // namespace fourd::edge_gradients
