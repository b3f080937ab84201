// Visibility edges are silhouette edges and the lines along which two triangles intersect. When vertices move, these
// edges move with them and change the image. This file computes the part of the gradient of the vertex positions that
// comes from moving visibility edges, for an image without antialiasing. Callers check shapes. Indices of vertices and
// triangles that are out of range are ignored.
#pragma once

#include "antialias/antialias.h"

namespace fourd::edge_gradients {

// `gradient` is the gradient of the loss with respect to Images::colours. The function writes the gradient with respect
// to Mesh::positions to `positions`. Each gradient has the shape of its input.
void edge_gradients(const antialias::Mesh& mesh, const antialias::Images& images, const antialias::Settings& settings,
                    const float* gradient, float* positions);

}  // namespace fourd::edge_gradients
