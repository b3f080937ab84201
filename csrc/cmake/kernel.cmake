# The library fourd_kernels and the functions that add to it:
#   fourd_kernel(NAME ...)               a kernel
#   fourd_add_module(NAME ...)           the Python module of all kernels added before
#   fourd_add_cuda_module(NAME ...)      the Python module of the kernels' CUDA sources, compiled for the GPU
#   fourd_add_emulated_module(NAME ...)  the Python module of the kernels' CUDA sources, compiled for the CPU
#   fourd_emulate(TARGET)                compiles the CUDA sources for the CPU into a program
include_guard(GLOBAL)
get_filename_component(FOURD_CSRC ${CMAKE_CURRENT_LIST_DIR} DIRECTORY)

set(CMAKE_CXX_STANDARD 17)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
option(FOURD_WERROR "Treat warnings as errors" OFF)
set(FOURD_SANITIZE "" CACHE STRING "Sanitizers to build with, e.g. address,undefined or thread")
find_package(Threads REQUIRED)
include(${CMAKE_CURRENT_LIST_DIR}/flags.cmake)

add_library(fourd_kernels STATIC ${FOURD_CSRC}/common/simd.cpp ${FOURD_CSRC}/common/team.cpp
  ${FOURD_CSRC}/tiles/depth_bins.cpp)
target_link_libraries(fourd_kernels PUBLIC fourd_options)
target_compile_options(fourd_kernels PRIVATE ${FOURD_EXACT} ${FOURD_WARNINGS})
set_target_properties(fourd_kernels PROPERTIES POSITION_INDEPENDENT_CODE ON)

# fourd_kernel(NAME [CPU file...] [DISPATCH file...] [WIDEST avx2|avx512] [EXACT|TOLERANT]
#              [CUDA file...] [BINDING file] [CUDA_BINDING file] [FOLDER folder])
# CPU           sources compiled once.
# DISPATCH      sources compiled once per instruction set, from the baseline to WIDEST (common/dispatch.h).
# EXACT         dispatched sources have no fused multiply-add, so instruction sets give the same bits (the default).
# TOLERANT      dispatched sources may use fused multiply-add, so bits can differ between instruction sets.
# CUDA          .cu files, for the GPU and for the emulation.
# BINDING       the file that defines fourd::bind_NAME(nanobind::module_&).
# CUDA_BINDING  the file that defines fourd::cuda::bind_NAME(nanobind::module_&).
# FOLDER        the folder of the files; csrc/NAME by default.
function(fourd_kernel name)
  cmake_parse_arguments(PARSE_ARGV 1 arg "EXACT;TOLERANT" "WIDEST;BINDING;CUDA_BINDING;FOLDER" "CPU;DISPATCH;CUDA")
  if(arg_UNPARSED_ARGUMENTS OR (arg_EXACT AND arg_TOLERANT))
    message(FATAL_ERROR "fourd_kernel(${name}): unexpected ${arg_UNPARSED_ARGUMENTS}, or both EXACT and TOLERANT")
  endif()
  if(NOT arg_FOLDER)
    set(arg_FOLDER ${FOURD_CSRC}/${name})
  endif()
  list(TRANSFORM arg_CPU PREPEND ${arg_FOLDER}/)
  list(TRANSFORM arg_DISPATCH PREPEND ${arg_FOLDER}/)
  list(TRANSFORM arg_CUDA PREPEND ${arg_FOLDER}/)
  target_sources(fourd_kernels PRIVATE ${arg_CPU})
  set(rounding ${FOURD_EXACT})
  if(arg_TOLERANT)
    set(rounding ${FOURD_TOLERANT})
  endif()
  fourd_instruction_sets(sets "${arg_WIDEST}")
  if(NOT arg_DISPATCH)
    set(sets "")
  endif()
  foreach(set IN LISTS sets)
    set(objects fourd_${name}_${set})
    add_library(${objects} OBJECT ${arg_DISPATCH})
    target_link_libraries(${objects} PRIVATE fourd_options)
    target_compile_definitions(${objects} PRIVATE FOURD_SIMD=${set})
    target_compile_options(${objects} PRIVATE ${FOURD_FLAGS_${set}} ${rounding} ${FOURD_VECTORIZE} ${FOURD_WARNINGS})
    set_target_properties(${objects} PROPERTIES POSITION_INDEPENDENT_CODE ON)
    target_sources(fourd_kernels PRIVATE $<TARGET_OBJECTS:${objects}>)
  endforeach()
  set_property(GLOBAL APPEND PROPERTY FOURD_CUDA_SOURCES ${arg_CUDA})
  foreach(kind BINDING CUDA_BINDING)
    if(arg_${kind})
      set_property(GLOBAL APPEND PROPERTY FOURD_${kind}_NAMES ${name})
      set_property(GLOBAL APPEND PROPERTY FOURD_${kind}_FILES ${arg_FOLDER}/${arg_${kind}})
    endif()
  endforeach()
endfunction()

# Writes the function bind_kernels of `namespace` (fourd or fourd::cuda). The function calls the binding function of
# each kernel.
function(fourd_generate_bindings kind namespace out)
  get_property(names GLOBAL PROPERTY FOURD_${kind}_NAMES)
  get_property(files GLOBAL PROPERTY FOURD_${kind}_FILES)
  set(declarations "")
  set(calls "")
  foreach(name IN LISTS names)
    string(APPEND declarations "void bind_${name}(nanobind::module_& module);\n")
    string(APPEND calls "    bind_${name}(module);\n")
  endforeach()
  set(generated ${CMAKE_CURRENT_BINARY_DIR}/generated/bind_${kind}.cpp)
  file(CONFIGURE OUTPUT ${generated} @ONLY CONTENT
    "#include <nanobind/nanobind.h>\n\nnamespace @namespace@ {\n\n@declarations@\nvoid bind_kernels(nanobind::module_& module) {\n@calls@}\n\n}  // namespace @namespace@\n")
  set(${out} ${files} ${generated} PARENT_SCOPE)
endfunction()

# Adds the CUDA sources to a target and compiles them for the CPU. Tests use such a target to emulate a GPU.
function(fourd_emulate target)
  get_property(sources GLOBAL PROPERTY FOURD_CUDA_SOURCES)
  target_sources(${target} PRIVATE ${FOURD_CSRC}/device/emulated.cpp)
  foreach(source IN LISTS sources)
    file(RELATIVE_PATH relative ${FOURD_CSRC} ${source})
    set(emulated ${CMAKE_CURRENT_BINARY_DIR}/emulated/${relative}.cpp)
    file(CONFIGURE OUTPUT ${emulated} CONTENT "#include \"${source}\"\n")
    # Hit tests must give the same bits as the reference, so multiplications and additions are not fused.
    set_source_files_properties(${emulated} PROPERTIES COMPILE_OPTIONS "${FOURD_EXACT}")
    target_sources(${target} PRIVATE ${emulated})
  endforeach()
  target_compile_definitions(${target} PRIVATE FOURD_EMULATED)
endfunction()

# Adds the Python module `target`. The given sources contain its entry point, which calls fourd::bind_kernels.
function(fourd_add_module target)
  fourd_generate_bindings(BINDING fourd bindings)
  nanobind_add_module(${target} NB_STATIC NOMINSIZE ${ARGN} ${bindings})
  target_link_libraries(${target} PRIVATE fourd_kernels)
  target_compile_options(${target} PRIVATE ${FOURD_WARNINGS})
endfunction()

# Adds the Python module `target` with the CUDA sources, compiled for the CPU. The given sources contain its entry
# point, which calls fourd::cuda::bind_kernels.
function(fourd_add_emulated_module target)
  fourd_generate_bindings(CUDA_BINDING fourd::cuda bindings)
  nanobind_add_module(${target} NB_STATIC NOMINSIZE NB_DOMAIN ${target} ${ARGN} ${bindings})
  target_link_libraries(${target} PRIVATE fourd_kernels)
  target_compile_options(${target} PRIVATE ${FOURD_WARNINGS})
  fourd_emulate(${target})
endfunction()

# Adds the Python module `target` with the CUDA sources, compiled for the GPU. The given sources contain its entry
# point, which calls fourd::cuda::bind_kernels. The language CUDA must be enabled.
function(fourd_add_cuda_module target)
  get_property(sources GLOBAL PROPERTY FOURD_CUDA_SOURCES)
  add_library(${target}_kernels STATIC ${sources} ${FOURD_CSRC}/device/mapped_counter.cu)
  set_target_properties(${target}_kernels PROPERTIES
    CUDA_STANDARD 17 CUDA_STANDARD_REQUIRED ON CUDA_ARCHITECTURES "${CMAKE_CUDA_ARCHITECTURES}"
    POSITION_INDEPENDENT_CODE ON)
  target_include_directories(${target}_kernels PUBLIC ${FOURD_CSRC})
  # Hit tests must give the same bits as the reference, so multiplications and additions are not fused.
  target_compile_options(${target}_kernels PRIVATE -fmad=false)
  if(NOT MSVC)
    target_compile_options(${target}_kernels PRIVATE -Xcompiler=-Wall,-Wextra)
  endif()
  if(FOURD_WERROR)
    target_compile_options(${target}_kernels PRIVATE -Werror=all-warnings)
  endif()
  fourd_generate_bindings(CUDA_BINDING fourd::cuda bindings)
  # Each module has its own nanobind domain, because the modules register types of the same names.
  nanobind_add_module(${target} NB_STATIC NOMINSIZE NB_DOMAIN ${target} ${ARGN} ${bindings})
  target_link_libraries(${target} PRIVATE ${target}_kernels fourd_kernels)
  target_compile_options(${target} PRIVATE ${FOURD_WARNINGS})
endfunction()
