# SPDX-License-Identifier: Apache-2.0
"""OpenGL from Mesa's libOSMesa, for machines that have it and no EGL. It runs on the CPU."""

from __future__ import annotations

import ctypes
from typing import Any

_LIBRARIES = ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")
_GL_UNSIGNED_BYTE = 0x1401
# GL/osmesa.h: OSMESA_FORMAT = GL_RGBA, OSMESA_PROFILE = core, version 3.3; 0 ends the list.
_ATTRIBUTES = (0x22, 0x1908, 0x33, 0x34, 0x36, 3, 0x37, 3, 0)
_SIDE = 4


class OSMesaContext:
    """What moderngl asks of a context object (see the package glcontext).

    Raises:
        OSError: the library is not installed, or has no OpenGL 3.3.
    """

    def __init__(self) -> None:
        self._library = _load()
        attributes = (ctypes.c_int * len(_ATTRIBUTES))(*_ATTRIBUTES)
        self._context: int | None = self._library.OSMesaCreateContextAttribs(attributes, None)
        if not self._context:
            raise OSError("OSMesaCreateContextAttribs failed: libOSMesa has no OpenGL 3.3")
        # A context needs a picture to draw to, though we only draw to framebuffers.
        self._pixels = (ctypes.c_ubyte * (4 * _SIDE * _SIDE))()
        self.__enter__()

    def load(self, name: str) -> int:
        """The address of an OpenGL function; 0 where there is none."""
        return self._library.OSMesaGetProcAddress(name.encode()) or 0

    def __enter__(self) -> OSMesaContext:
        if not self._library.OSMesaMakeCurrent(
            self._context, self._pixels, _GL_UNSIGNED_BYTE, _SIDE, _SIDE
        ):
            raise OSError("OSMesaMakeCurrent failed")
        return self

    def __exit__(self, *_: object) -> None:
        self._library.OSMesaMakeCurrent(None, None, _GL_UNSIGNED_BYTE, 0, 0)

    def release(self) -> None:
        if self._context is not None:
            self._library.OSMesaDestroyContext(self._context)
            self._context = None


def _load() -> Any:
    library = None
    for name in _LIBRARIES:
        try:
            library = ctypes.CDLL(name)
            break
        except OSError:
            continue
    if library is None:
        raise OSError(f"{_LIBRARIES[0]} not loaded")
    pointer, text, number = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int
    library.OSMesaCreateContextAttribs.restype = pointer
    library.OSMesaCreateContextAttribs.argtypes = [pointer, pointer]
    library.OSMesaMakeCurrent.restype = ctypes.c_ubyte
    library.OSMesaMakeCurrent.argtypes = [pointer, pointer, ctypes.c_uint, number, number]
    library.OSMesaGetProcAddress.restype = pointer
    library.OSMesaGetProcAddress.argtypes = [text]
    library.OSMesaDestroyContext.argtypes = [pointer]
    return library
