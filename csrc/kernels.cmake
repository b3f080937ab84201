# The kernels as one library, for the Python module and for the programs of tests/.
set(FOURD_KERNELS ${CMAKE_CURRENT_LIST_DIR})
add_library(fourd_kernels STATIC
  ${FOURD_KERNELS}/blend/cpu/blend.cpp
  ${FOURD_KERNELS}/blend/cpu/runs_baseline.cpp
  ${FOURD_KERNELS}/common/simd.cpp
  ${FOURD_KERNELS}/common/team.cpp
  ${FOURD_KERNELS}/hashgrid/cpu/encode.cpp
  ${FOURD_KERNELS}/planes/cpu/sample.cpp
  ${FOURD_KERNELS}/play/player.cpp
  ${FOURD_KERNELS}/points/cpu/bins.cpp
  ${FOURD_KERNELS}/points/cpu/dispatch.cpp
  ${FOURD_KERNELS}/points/cpu/render.cpp
  ${FOURD_KERNELS}/points/cpu/tiles_baseline.cpp
  ${FOURD_KERNELS}/shade/cpu/shade.cpp
  ${FOURD_KERNELS}/similarity/cpu/similarity.cpp
  ${FOURD_KERNELS}/sources/cpu/sample.cpp
)
# Their promise is a tolerance: sums may be fused, and choices between numbers made without branches.
set(FOURD_TOLERANT -ffp-contract=fast -fno-trapping-math -fno-math-errno)
set_source_files_properties(${FOURD_KERNELS}/hashgrid/cpu/encode.cpp ${FOURD_KERNELS}/planes/cpu/sample.cpp
  ${FOURD_KERNELS}/similarity/cpu/similarity.cpp ${FOURD_KERNELS}/sources/cpu/sample.cpp
  PROPERTIES COMPILE_OPTIONS "${FOURD_TOLERANT}")
set_source_files_properties(${FOURD_KERNELS}/blend/cpu/runs_baseline.cpp
  PROPERTIES COMPILE_OPTIONS "${FOURD_TOLERANT}")
# Nothing that may trap is asked for, so that choices between numbers need no branches; the bits stay the same.
set(FOURD_EXACT -fno-trapping-math -fno-math-errno)
set_source_files_properties(${FOURD_KERNELS}/points/cpu/tiles_baseline.cpp PROPERTIES COMPILE_OPTIONS "${FOURD_EXACT}")
# Each instruction set has its own copy of the tile kernels; which one runs is decided at run time.
if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64|amd64")
  target_compile_definitions(fourd_kernels PRIVATE FOURD_X86)
  target_sources(fourd_kernels PRIVATE
    ${FOURD_KERNELS}/blend/cpu/runs_avx2.cpp
    ${FOURD_KERNELS}/blend/cpu/runs_avx512.cpp
    ${FOURD_KERNELS}/points/cpu/tiles_avx2.cpp
    ${FOURD_KERNELS}/points/cpu/tiles_avx512.cpp
    ${FOURD_KERNELS}/shade/cpu/shade_avx2.cpp)
  set_source_files_properties(${FOURD_KERNELS}/points/cpu/tiles_avx2.cpp PROPERTIES
    COMPILE_OPTIONS "-mavx2;${FOURD_EXACT}")
  set_source_files_properties(${FOURD_KERNELS}/shade/cpu/shade_avx2.cpp PROPERTIES
    COMPILE_OPTIONS "-mavx2;-mfma;-mf16c;${FOURD_TOLERANT}")
  set_source_files_properties(${FOURD_KERNELS}/blend/cpu/runs_avx2.cpp PROPERTIES
    COMPILE_OPTIONS "-mavx2;-mfma;${FOURD_TOLERANT}")
  set_source_files_properties(${FOURD_KERNELS}/blend/cpu/runs_avx512.cpp PROPERTIES
    COMPILE_OPTIONS "-mavx512f;-mavx512dq;-mavx512vl;-mfma;-mprefer-vector-width=512;${FOURD_TOLERANT}")
  # GCC 12 takes the undefined vectors in its own AVX-512 header for mistakes of ours (GCC bug 105593).
  set_source_files_properties(${FOURD_KERNELS}/points/cpu/tiles_avx512.cpp PROPERTIES
    COMPILE_OPTIONS "-mavx512f;-mavx512dq;-mavx512vl;${FOURD_EXACT};-Wno-maybe-uninitialized;-Wno-uninitialized")
endif()
set_target_properties(fourd_kernels PROPERTIES POSITION_INDEPENDENT_CODE ON)
target_include_directories(fourd_kernels PUBLIC ${FOURD_KERNELS})
target_link_libraries(fourd_kernels PUBLIC Threads::Threads)
# The renderer promises the reference's bits in its hit tests: no contraction into FMA.
target_compile_options(fourd_kernels PRIVATE -Wall -Wextra -Wpedantic -ffp-contract=off)
if(FOURD_WERROR)
  target_compile_options(fourd_kernels PRIVATE -Werror)
endif()
if(FOURD_SANITIZE)
  target_compile_options(fourd_kernels PUBLIC
    -O1 -g -fno-omit-frame-pointer -fsanitize=${FOURD_SANITIZE} -fno-sanitize-recover=all)
  target_link_options(fourd_kernels PUBLIC -fsanitize=${FOURD_SANITIZE})
endif()
