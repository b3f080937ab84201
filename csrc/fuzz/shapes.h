// Rules for valid sizes of the arguments of all functions that are bound to Python. A fuzzer needs them because few
// combinations of random sizes would be valid.
//
// A rule NAME=A,B gives the sizes of the free axes (axes that may have any size) of the array NAME, or the value of the
// integer argument NAME. NAME*L gives the length L of a list. NAME*L=A,B gives the length, and the sizes of the arrays
// in the list. NAME<N limits the values of an int32 array to the range from 0 to N - 1. A capital letter stands for the
// same size everywhere in one call. 2AB is a product, and A+B is a sum. A> is the size A, halved once for each
// preceding array of the list, but at least 1. Sizes without a rule are chosen independently.
#pragma once

namespace fourd::fuzz {

struct Shapes {
    const char* function;
    const char* rules;
};

inline constexpr Shapes kShapes[] = {
    {"antialias", "color=B,H,W,C rast=B,H,W pos=1,V tri=T tri<V opposite=T opposite<V out=B,H,W,C codes=B,H,W"},
    {"antialias", "color=B,H,W,C rast=B,H,W pos=B,V tri=T tri<V opposite=T opposite<V out=B,H,W,C codes=B,H,W"},
    {"antialias_backward",
     "color=B,H,W,C rast=B,H,W pos=1,V tri=T tri<V gradient=B,H,W,C codes=B,H,W out_color=B,H,W,C out_pos=1,V"},
    {"antialias_backward",
     "color=B,H,W,C rast=B,H,W pos=B,V tri=T tri<V gradient=B,H,W,C codes=B,H,W out_color=B,H,W,C out_pos=B,V"},
    {"edge_gradients", "color=B,H,W,C rast=B,H,W pos=1,V tri=T tri<V opposite=T opposite<V gradient=B,H,W,C out_pos=1,V"},
    {"edge_gradients", "color=B,H,W,C rast=B,H,W pos=B,V tri=T tri<V opposite=T opposite<V gradient=B,H,W,C out_pos=B,V"},
    {"blend_logits", "point=N,H samples=V,C,N weight=C,H out=H logits=V,N"},
    {"blend_logits_backward",
     "point=N,H samples=V,C,N weight=C,H out=H logits=V,N grad_logits=V,N out_point=N,H out_samples=V,C,N "
     "out_weight=C,H out_out=H out_bias=1"},
    {"encode_hash_grid", "resolutions*L coordinates=N log2_entries=3 table=8L,F out=N,LF"},
    {"encode_hash_grid_backward",
     "resolutions*L coordinates=N log2_entries=3 table=8L,F gradient=N,LF out_table=8L,F out_coordinates=N"},
    {"interpolate_attributes", "attr=1,V,C rast=B,H,W,4 tri=T tri<V rast_db=B,H,W,4 diff=D diff<C out=B,H,W,C out_da=B,H,W,2D"},
    {"interpolate_attributes", "attr=B,V,C rast=B,H,W,4 tri=T tri<V rast_db=B,H,W,4 diff=D diff<C out=B,H,W,C out_da=B,H,W,2D"},
    {"interpolate_attributes_backward",
     "attr=1,V,C rast=B,H,W,4 tri=T tri<V rast_db=B,H,W,4 diff=D diff<C grad_out=B,H,W,C grad_da=B,H,W,2D grad_attr=1,V,C "
     "grad_rast=B,H,W,4 grad_db=B,H,W,4"},
    {"interpolate_attributes_backward",
     "attr=B,V,C rast=B,H,W,4 tri=T tri<V rast_db=B,H,W,4 diff=D diff<C grad_out=B,H,W,C grad_da=B,H,W,2D grad_attr=B,V,C "
     "grad_rast=B,H,W,4 grad_db=B,H,W,4"},
    {"filter_pixels", "image=H,W out=H,W"},
    {"sample_planes", "coordinates=N planes*P=H,W,F axes*2P out=N,PF"},
    {"sample_planes_backward",
     "coordinates=N planes*P=H,W,F axes*2P gradient=N,PF out_planes*P=H,W,F out_coordinates=N"},
    {"Player.draw",
     "xyz=N radius=N density=N sh=N blend_weights=N,V rgb=N,V chosen=K chosen<V view_weights=K camera*21 background*3 "
     "out=H,W"},
    {"Player.draw_surface",
     "xyz=N radius=N density=N sh=N blend_weights=N,V rgb=N,V normals=N chosen=K chosen<V view_weights=K camera*21 "
     "albedo=H,W inverse_depth=H,W normal=H,W"},
    {"DepthSorter.sort", "xyz=N radius=N density=N camera*21 width=W height=H out=N"},
    {"render_points",
     "xyz=N features=N,C radius=N density=N camera*21 out_features=H,W,C out_alpha=H,W out_depth=H,W"},
    {"render_points_backward",
     "xyz=N features=N,C radius=N density=N camera*21 grad_features=H,W,C grad_alpha=H,W grad_depth=H,W out_xyz=N "
     "out_features=N,C out_radius=N out_density=N"},
    {"point_visibility", "xyz=N radius=N density=N camera*21 width=W height=H out=N"},
    {"rasterize_triangles", "pos=1,V tri=T tri<V ranges=B ranges<T previous=B,H,W rast=B,H,W rast_db=B,H,W"},
    {"rasterize_triangles", "pos=B,V tri=T tri<V previous=B,H,W rast=B,H,W rast_db=B,H,W"},
    {"rasterize_triangles_backward",
     "pos=1,V tri=T tri<V ranges=B ranges<T rast=B,H,W grad_rast=B,H,W grad_db=B,H,W grad_pos=1,V"},
    {"rasterize_triangles_backward", "pos=B,V tri=T tri<V rast=B,H,W grad_rast=B,H,W grad_db=B,H,W grad_pos=B,V"},
    {"build_rays", "xyz=V tri=T tri<V"},
    {"refit_rays", "xyz=V tri=T tri<V"},
    {"rays_cost", ""},
    {"trace_rays",
     "origins=N directions=N t_min=1 t_max=N after_t=N after_triangle=N after_triangle<T t=N,L u=N,L v=N,L triangle=N,L"},
    {"trace_rays",
     "origins=N directions=N t_min=N t_max=1 after_t=N after_triangle=N after_triangle<T t=N,L u=N,L v=N,L triangle=N,L"},
    {"occluded_rays", "origins=N directions=N t_min=1 t_max=N out=N"},
    {"trace_rays_backward",
     "xyz=V tri=T tri<V origins=N directions=N t=N,L u=N,L v=N,L triangle=N,L triangle<T to_t=N,L to_u=N,L to_v=N,L to_xyz=V "
     "to_origins=N to_directions=N"},
    {"build_discs", "xyz=D radius=D density=D"},
    {"composite_discs", "colours=D origins=N directions=N t_min=1 t_max=N out=N"},
    {"shade", "xyz=N sh=N blend_weights=N,V rgb=N,V chosen=K chosen<V view_weights=K"},
    {"similarity", "picture=H,W,C truth=H,W,C out_gradient=H,W,C"},
    {"rasterize_soft", "xyz=V tri=T tri<V features=T,C camera*21 softness*7 out_features=H,W,C out_alpha=H,W"},
    {"rasterize_soft_backward",
     "xyz=V tri=T tri<V features=T,C camera*21 softness*7 grad_features=H,W,C grad_alpha=H,W out_xyz=V out_features=T,C"},
    {"sample_sources",
     "xyz=N images=B,H,W mattes=B,H,W depth=B,H,W features=B,Y,X,C cameras*21B softness=N out_channels=B,C+3,N "
     "out_visibility=B,N"},
    {"sample_sources_backward",
     "xyz=N images=B,H,W mattes=B,H,W features=B,Y,X,C cameras*21B gradient=B,C+3,N out_xyz=N out_features=B,Y,X,C"},
    {"splat_triangles",
     "xyz=V tri=T tri<V features=T,C opacity=T sigma=T camera*21 out_features=H,W,C out_alpha=H,W out_transmittance=H,W "
     "out_normal=H,W,3 out_depth=H,W out_weight=T"},
    {"splat_triangles",
     "xyz=V tri=T tri<V features=T,C+4 opacity=T sigma=T camera*21 out_features=H,W,C out_alpha=H,W out_transmittance=H,W "
     "out_normal=H,W,3 out_depth=H,W out_weight=T"},
    {"splat_triangles_backward",
     "xyz=V tri=T tri<V features=T,C opacity=T sigma=T camera*21 rendered_features=H,W,C rendered_alpha=H,W "
     "rendered_transmittance=H,W rendered_normal=H,W,3 rendered_depth=H,W grad_features=H,W,C grad_alpha=H,W "
     "grad_normal=H,W,3 grad_depth=H,W out_xyz=V out_features=T,C out_opacity=T out_sigma=T"},
    {"splat_triangles_backward",
     "xyz=V tri=T tri<V features=T,C+4 opacity=T sigma=T camera*21 rendered_features=H,W,C rendered_alpha=H,W "
     "rendered_transmittance=H,W rendered_normal=H,W,3 rendered_depth=H,W grad_features=H,W,C grad_alpha=H,W "
     "grad_normal=H,W,3 grad_depth=H,W out_xyz=V out_features=T,C+4 out_opacity=T out_sigma=T"},
    {"stylize",
     "albedo=H,W inverse_depth=H,W normal=H,W numbers=38 table=R line_state=H,W out=H,W"},
    {"sample_texture", "levels*L=I,1,H>,W>,C uv=I,N,2 uv_da=I,N,4 bias=I,N out=I,N,C"},
    {"sample_texture", "levels*L=1,6,H>,H>,C uv=I,N,3 uv_da=I,N,6 bias=I,N out=I,N,C"},
    {"sample_texture_backward",
     "levels*L=I,1,H>,W>,C uv=I,N,2 uv_da=I,N,4 bias=I,N gradient=I,N,C out_levels*L=I,1,H>,W>,C out_uv=I,N,2 "
     "out_uv_da=I,N,4 out_bias=I,N"},
    {"sample_texture_backward",
     "levels*L=1,6,H>,H>,C uv=I,N,3 uv_da=I,N,6 bias=I,N gradient=I,N,C out_levels*L=1,6,H>,H>,C out_uv=I,N,3 "
     "out_uv_da=I,N,6 out_bias=I,N"},
    {"build_mips", "texture=I,1,2H,2W,C out*L=I,1,H>,W>,C"},
    {"build_mips", "texture=I,6,2H,2H,C out*L=I,6,H>,H>,C"},
    {"unpack_harmonics", "content=2RN basis=R,48 mean=48 out=N,48"},
    {"unpack_positions", "content=BN lower=3 out=N,3"},
    {"unpack_views", "contents*V=N+3N mean=N,3 weights=256 out_weights=N,V out_rgb=N,V"},
};

}  // namespace fourd::fuzz
