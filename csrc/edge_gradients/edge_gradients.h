// Visibility edges move with the vertices, which changes the image. This file computes the corresponding part of the
// gradient with respect to the vertex positions, for an image without antialiasing. Callers check shapes. Indices of
// vertices and triangles that are out of range are ignored.
#pragma once

#include "antialias/antialias.h"

namespace fourd::edge_gradients {

// `gradient` is the gradient of the loss with respect to the colours. Writes the gradient with respect to
// Mesh::positions to `positions`, an array of the same shape.
void edge_gradients(const antialias::Mesh& mesh, const antialias::Images& images, const antialias::Settings& settings,
                    const float* gradient, float* positions);

}  // namespace fourd::edge_gradients
