# Compiler flags. The target fourd_options has the include directories, definitions and libraries of every source.
#
#   FOURD_WARNINGS     Warnings. They are errors if FOURD_WERROR is on.
#   FOURD_FLAGS_<set>  Flags of an instruction set: baseline, avx2 or avx512.
#   FOURD_EXACT        No fused multiply-add, so that results have the same bits with every instruction set.
#   FOURD_TOLERANT     The compiler may use fused multiply-add.
#   FOURD_VECTORIZE    Conditional expressions compile without branches, because floating-point exceptions are ignored.
#                      Results are unchanged.

add_library(fourd_options INTERFACE)
target_include_directories(fourd_options INTERFACE ${FOURD_CSRC})
target_link_libraries(fourd_options INTERFACE Threads::Threads)

set(FOURD_X86 OFF)
if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64|amd64" AND NOT "${CMAKE_OSX_ARCHITECTURES}" MATCHES "arm64")
  set(FOURD_X86 ON)
  target_compile_definitions(fourd_options INTERFACE FOURD_X86)
endif()

set(FOURD_FLAGS_baseline "")
if(MSVC)
  set(FOURD_WARNINGS /W4)
  set(FOURD_FLAGS_avx2 /arch:AVX2)
  set(FOURD_FLAGS_avx512 /arch:AVX512)
  if(CMAKE_CXX_COMPILER_ID STREQUAL "MSVC")
    set(FOURD_EXACT /fp:precise)
    set(FOURD_TOLERANT /fp:contract)
  else()  # clang-cl
    set(FOURD_EXACT /clang:-ffp-contract=off)
    set(FOURD_TOLERANT /clang:-ffp-contract=fast)
  endif()
  set(FOURD_VECTORIZE "")
  set(FOURD_AS_ERRORS /WX)
  target_compile_definitions(fourd_options INTERFACE NOMINMAX _CRT_SECURE_NO_WARNINGS)
else()
  set(FOURD_WARNINGS -Wall -Wextra -Wpedantic)
  # The compiler may use prfchw, which prefetches for writing. Processors without this instruction ignore it.
  set(FOURD_FLAGS_avx2 -mavx2 -mfma -mf16c -mprfchw)
  set(FOURD_FLAGS_avx512 -mavx512f -mavx512dq -mavx512vl -mfma)
  set(FOURD_EXACT -ffp-contract=off)
  set(FOURD_TOLERANT -ffp-contract=fast)
  set(FOURD_VECTORIZE -fno-trapping-math -fno-math-errno)
  set(FOURD_AS_ERRORS -Werror)
  if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
    # GCC warns about uninitialised vectors in its own AVX-512 header (GCC bug 105593).
    list(APPEND FOURD_FLAGS_avx512 -mprefer-vector-width=512 -Wno-maybe-uninitialized -Wno-uninitialized)
  endif()
endif()
if(FOURD_WERROR)
  list(APPEND FOURD_WARNINGS ${FOURD_AS_ERRORS})
endif()

if(FOURD_SANITIZE)
  set(sanitizers -fsanitize=${FOURD_SANITIZE})
  target_compile_options(fourd_options INTERFACE -O1 -g -fno-omit-frame-pointer ${sanitizers} -fno-sanitize-recover=all)
  target_link_options(fourd_options INTERFACE ${sanitizers})
endif()

# Sets `out` to the list of instruction sets from the baseline up to `widest`. If `widest` is empty, the list contains
# only the baseline.
function(fourd_instruction_sets out widest)
  set(sets baseline)
  if(FOURD_X86 AND widest MATCHES "^avx(2|512)$")
    list(APPEND sets avx2)
  endif()
  if(FOURD_X86 AND widest STREQUAL "avx512")
    list(APPEND sets avx512)
  endif()
  set(${out} ${sets} PARENT_SCOPE)
endfunction()
