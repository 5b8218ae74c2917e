"""Memory that processes share by mapping a file, and that nobody can pull away.

A file that is cut short under a mapping is a SIGBUS for the process that touches the rest, and ends it. Here SIGBUS is
answered: every mapped file that has become too short gets its length back, filled with zeros, before the instruction
runs again. Where the file system has no room, the mapping becomes private memory. A SIGBUS of any other cause ends the
process as ever. The owner of the content writes its head anew. Why not otherwise: docs/adr.
"""

import contextlib
import ctypes
import mmap
import os
import signal
from typing import NamedTuple

_MAP_PRIVATE, _MAP_FIXED, _MAP_ANONYMOUS = 0x02, 0x10, 0x20  # Linux, on x86-64 and aarch64 alike


class _Guarded(NamedTuple):
    """fd: of the mapped file, for this alone. address: 0 where it is not known."""

    fd: int
    size: int
    address: int
    protection: int


_guarded: dict[int, _Guarded] = {}  # by the identity of the mapping
_restored: set[int] = set()  # of those that got their length back, until somebody asks
_libc = ctypes.PyDLL(None)  # keeps the interpreter's lock: the handler interrupts an instruction of Python itself
_libc.signal.restype = _libc.mmap.restype = ctypes.c_void_p
_libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long]


def map_shared(fd: int, size: int, protection: int = mmap.PROT_READ | mmap.PROT_WRITE) -> mmap.mmap:
    """Map an open file, populated. End it by `unmap`. Raises OSError.

    The mapping is of a description of its own, so that a forked child, which inherits it, keeps no lock of `fd`.
    """
    own = os.open(f"/proc/self/fd/{fd}", os.O_RDWR | os.O_CLOEXEC)
    try:
        mapped = mmap.mmap(own, size, mmap.MAP_SHARED | mmap.MAP_POPULATE, protection)
    except BaseException:
        os.close(own)
        raise
    address = ctypes.addressof(ctypes.c_char.from_buffer(mapped)) if protection & mmap.PROT_WRITE else 0
    _guarded[id(mapped)] = _Guarded(own, size, address, protection)
    _libc.signal(signal.SIGBUS, _handler)
    return mapped


def shortened(mapped: mmap.mmap) -> bool:
    """Whether the file has been shorter than the mapping since the last call; it gets its length back, where there is
    room.
    """
    found = _guarded[id(mapped)]
    if os.fstat(found.fd).st_size >= found.size:
        was = id(mapped) in _restored
        _restored.discard(id(mapped))
        return was
    with contextlib.suppress(OSError):
        os.posix_fallocate(found.fd, 0, found.size)
    return True


def unmap(mapped: mmap.mmap) -> None:
    """Close a mapping; idempotent."""
    _restored.discard(id(mapped))  # the identity may be that of the next mapping
    if found := _guarded.pop(id(mapped), None):
        os.close(found.fd)
    mapped.close()


def _answer(_number: int) -> None:
    """SIGBUS: give every file that is too short its length back; where none is, let the signal end the process."""
    found = {key: one for key, one in _guarded.items() if os.fstat(one.fd).st_size < one.size}
    _restored.update(found)
    for fd, size, address, protection in found.values():
        try:
            os.posix_fallocate(fd, 0, size)
        except OSError:
            flags = _MAP_PRIVATE | _MAP_FIXED | _MAP_ANONYMOUS
            if not address or _libc.mmap(address, size, protection, flags, -1, 0) != address:
                found = {}
    if not found:
        _libc.signal(signal.SIGBUS, None)


_handler = ctypes.CFUNCTYPE(None, ctypes.c_int)(_answer)
