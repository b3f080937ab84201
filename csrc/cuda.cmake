# The CUDA kernels: as a module where nvcc is found, and emulated on the CPU for tests.
set(FOURD_CUDA_ROOT ${CMAKE_CURRENT_LIST_DIR})
set(FOURD_CUDA_SOURCES
  hashgrid/cuda/encode
  planes/cuda/sample
  play/cuda/draw
  points/cuda/render
  sources/cuda/sample
)
set(FOURD_CUDA_BINDINGS
  binding/cuda/bind.cpp
  binding/cuda/hashgrid.cpp
  binding/cuda/planes.cpp
  binding/cuda/play.cpp
  binding/cuda/points.cpp
  binding/cuda/sources.cpp
)

# Adds the kernels, compiled for the CPU, to a target.
function(fourd_emulate target)
  target_sources(${target} PRIVATE ${FOURD_CUDA_ROOT}/device/emulated.cpp)
  foreach(source IN LISTS FOURD_CUDA_SOURCES)
    set(emulated ${CMAKE_CURRENT_BINARY_DIR}/emulated/${source}.cpp)
    file(CONFIGURE OUTPUT ${emulated} CONTENT "#include \"${source}.cu\"\n")
    # As on a GPU: hit tests give the reference's bits.
    set_source_files_properties(${emulated} PROPERTIES COMPILE_OPTIONS -ffp-contract=off)
    target_sources(${target} PRIVATE ${emulated})
  endforeach()
  target_compile_definitions(${target} PRIVATE FOURD_EMULATED)
endfunction()

# Adds fourd._cuda; the language CUDA is on.
function(fourd_add_cuda_module)
  set(sources device/shared_number.cu)
  foreach(source IN LISTS FOURD_CUDA_SOURCES)
    list(APPEND sources ${source}.cu)
  endforeach()
  add_library(fourd_cuda_kernels STATIC ${sources})
  set_target_properties(fourd_cuda_kernels PROPERTIES
    CUDA_STANDARD 17 CUDA_STANDARD_REQUIRED ON CUDA_ARCHITECTURES "${CMAKE_CUDA_ARCHITECTURES}"
    POSITION_INDEPENDENT_CODE ON)
  target_include_directories(fourd_cuda_kernels PUBLIC ${CMAKE_CURRENT_SOURCE_DIR})
  # The renderer promises the reference's bits in its hit tests: no contraction into FMA.
  target_compile_options(fourd_cuda_kernels PRIVATE -fmad=false -Xcompiler=-Wall,-Wextra)
  if(FOURD_WERROR)
    target_compile_options(fourd_cuda_kernels PRIVATE -Werror=all-warnings)
  endif()
  # Of a domain of its own: it has other types under the names of those emulated.
  nanobind_add_module(_cuda NB_STATIC NOMINSIZE NB_DOMAIN fourd_cuda 
    binding/convert.cpp binding/cuda/module.cpp ${FOURD_CUDA_BINDINGS})
  target_link_libraries(_cuda PRIVATE fourd_cuda_kernels fourd_kernels)
  fourd_strict(_cuda)
  install(TARGETS _cuda LIBRARY DESTINATION fourd)
endfunction()
