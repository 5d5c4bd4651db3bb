# interface_package(<package>...): a ROS interface package from the current folder's msg/, srv/ and action/, which uses
# messages of <package>...
#
# A macro: the generators work with variables of the calling folder.
macro(interface_package)
  set(_dependencies ${ARGN})
  find_package(ament_cmake REQUIRED)
  find_package(rosidl_default_generators REQUIRED)
  foreach(_dependency ${_dependencies})
    find_package(${_dependency} REQUIRED)
  endforeach()

  # The imported Python targets name the NumPy headers of the machine that built them.
  get_property(_imported DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(_target ${_imported})
    if(_target MATCHES "__rosidl_generator_py$")
      set_target_properties(${_target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "")
    endif()
  endforeach()

  # Generators for C++ registered themselves as they were found: they are left out. Python asks for its type support
  # by way of the dispatch alone.
  list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")
  macro(rosidl_generator_py_get_typesupports result)
    set(${result} rosidl_typesupport_c)
  endmacro()

  file(GLOB _files CONFIGURE_DEPENDS RELATIVE "${CMAKE_CURRENT_SOURCE_DIR}" "msg/*.msg" "srv/*.srv" "action/*.action")
  rosidl_generate_interfaces(${PROJECT_NAME} ${_files} DEPENDENCIES ${_dependencies})
  ament_package()
endmacro()
