# Installs a module of the package, and its type stub, which nanobind generates from the compiled module.
function(fourd_install module)
  install(TARGETS ${module} LIBRARY DESTINATION fourd)
  if(CMAKE_CROSSCOMPILING)
    return()  # the module cannot be imported here
  endif()
  set(stub ${CMAKE_CURRENT_BINARY_DIR}/stubs/${module}.pyi)
  nanobind_add_stub(${module}_stub MODULE ${module} OUTPUT ${stub}
    PYTHON_PATH $<TARGET_FILE_DIR:${module}> DEPENDS ${module})
  install(FILES ${stub} DESTINATION fourd)
  if("${SKBUILD_STATE}" STREQUAL "editable")
    # Type checkers look for the stub beside the sources, not in the folder of an editable install.
    add_custom_command(TARGET ${module}_stub POST_BUILD
      COMMAND ${CMAKE_COMMAND} -E copy ${stub} ${CMAKE_CURRENT_SOURCE_DIR}/../fourd/${module}.pyi)
  endif()
endfunction()
