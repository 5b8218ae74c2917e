"""A process for code that came with a file: it reads and computes, and that is all.

A child made by fork, under a seccomp filter that knows the system calls of a computation and answers all others with
EPERM. It has no network, no file opened for writing, nothing renamed or deleted, no other program, no signal to
another process, no ioctl of a terminal. Its answer comes through a pipe, as JSON. Seccomp needs no privilege, and
containers allow it. Landlock, the alternative, is missing from older kernels, and knows no signals before Linux 6.12.
"""

import ctypes
import json
import os
import platform
import resource
import signal
import struct
import tempfile
from collections.abc import Callable
from typing import Any, NamedTuple

from drivers.base.text_file import printable, words_of

LARGEST_ANSWER = 2**28  # bytes

_NOT_READING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND  # flags of open that are not allowed
_CLONE_THREAD = 0x10000
_FCNTLS = (0, 1, 2, 3, 1030)  # F_DUPFD, F_GETFD, F_SETFD, F_GETFL, F_DUPFD_CLOEXEC
_IOCTLS = (0x5401, 0x5413)  # TCGETS, TIOCGWINSZ


class _Machine(NamedTuple):
    """Numbers of a processor: architecture in seccomp, calls with conditions, calls without."""

    arch: int
    openat: int
    clone: int
    clone3: int
    fcntl: int
    ioctl: int
    others: tuple[int, ...]


# Files: read, write, seek, close, stat, readlink, getdents, poll. Memory: mmap to madvise. Time, timers, own signals,
# futex, thread set-up, random numbers, own ids and limits, exit.
_MACHINES = {
    "x86_64": _Machine(
        0xC000003E, 257, 56, 435, 72, 16,
        (*range(16), 17, 19, 20, 21, 23, 24, 25, 28, 32, 35, 36, 38, 39, 60, 63, 79, 89, *range(96, 101), 102, 104, 107,
         108, 110, 131, 158, 186, 201, 202, 204, *range(217, 220), *range(228, 232), 262, 267, *range(269, 272), 273,
         309, 318, 324, 332, 334, 439),
    ),
    "aarch64": _Machine(
        0xC00000B7, 56, 220, 435, 25, 29,
        (17, 23, 48, 57, *range(61, 68), 69, 72, 73, 78, 79, 80, 93, 94, 96, *range(98, 104), *range(113, 116), 123,
         124, 128, 132, 134, 135, 139, 153, 160, 163, 165, 168, 169, *range(172, 180), *range(214, 217), 222, 226, 233,
         278, 283, 291, 293, 439),
    ),
}  # fmt: skip
_ALLOW, _EPERM, _ENOSYS = 0x7FFF0000, 0x00050001, 0x00050026
_NR, _ARCH, _ARGS = 0, 4, 16
_LOAD, _EQUALS, _ANY_BIT, _RETURN = 0x20, 0x15, 0x45, 0x06
_NO_NEW_PRIVS, _SET_SECCOMP, _FILTER = 38, 22, 2


class ConfinedError(Exception):
    """The work came to nothing; the text says why, in one line without control characters."""


def confined(work: Callable[[Callable[[], None]], Any]) -> Any:
    """Run `work` in a process of its own; what it returns, as JSON has it. It calls what it is given just before any
    code that came with a file runs: from then on the process only reads and computes. What it prints goes nowhere.

    Raises ConfinedError with what it raised, where it ended otherwise, or where the kernel has no seccomp.
    """
    with tempfile.TemporaryDirectory(prefix="hil-confined-") as scratch:
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            _be_child(work, writing, scratch)
        os.close(writing)
        with os.fdopen(reading, "rb") as output:
            said = output.read(LARGEST_ANSWER + 1)
        if len(said) > LARGEST_ANSWER:
            os.kill(child, signal.SIGKILL)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    try:
        answer = json.loads(said)
        if status == 0 and isinstance(answer, list) and len(answer) == 1:
            return answer[0]
        text = answer["error"]
    except (ValueError, KeyError, TypeError, RecursionError):
        text = f"the code that it carries ended its process with status {status} and no answer"
    raise ConfinedError(" ".join(printable(str(text)).split()))


def _be_child(work: Callable[[Callable[[], None]], Any], writing: int, scratch: str) -> None:
    """Never returns."""
    status = 1
    try:
        tempfile.tempdir = scratch  # which the parent removes: this process will not be able to
        nothing = os.open(os.devnull, os.O_RDWR)
        for target in (0, 1, 2):
            os.dup2(nothing, target)
        answer = os.dup2(writing, 3)
        os.closerange(4, resource.getrlimit(resource.RLIMIT_NOFILE)[0])
        try:
            text, status = json.dumps([work(confine)]), 0
        except Exception as error:
            text = json.dumps({"error": words_of(error)})
        with os.fdopen(answer, "w") as stream:
            stream.write(text)
    finally:
        os._exit(status)


def confine() -> None:
    """Put this process under the filter, for good. Raises ConfinedError where processor or kernel know none."""
    machine = _MACHINES.get(platform.machine())
    if machine is None:
        raise ConfinedError(f"no code that came with a file is run on {platform.machine()}: no filter is known for it")
    code = _program(machine)
    buffer = ctypes.create_string_buffer(code)
    program = struct.pack("HxxxxxxP", len(code) // 8, ctypes.addressof(buffer))
    libc = ctypes.CDLL(None, use_errno=True)
    for arguments in ((_NO_NEW_PRIVS, 1, 0, 0, 0), (_SET_SECCOMP, _FILTER, program, 0, 0)):
        if libc.prctl(*arguments):
            why = os.strerror(ctypes.get_errno())
            raise ConfinedError(f"code that came with a file is not run here: the kernel refuses seccomp: {why}")


def _program(machine: _Machine) -> bytes:
    """The filter: conditional calls first, each a block that returns, then those that are allowed."""
    lines = [(_LOAD, 0, 0, _ARCH), (_EQUALS, 1, 0, machine.arch), (_RETURN, 0, 0, _EPERM), (_LOAD, 0, 0, _NR)]
    lines += [(_EQUALS, 0, 1, machine.clone3), (_RETURN, 0, 0, _ENOSYS)]  # glibc then takes clone, whose flags show
    ends = [(_RETURN, 0, 0, _EPERM), (_RETURN, 0, 0, _ALLOW)]
    lines += _when(machine.openat, 2, [(_ANY_BIT, 0, 1, _NOT_READING), *ends])
    lines += _when(machine.clone, 0, [(_ANY_BIT, 1, 0, _CLONE_THREAD), *ends])
    for number, known in ((machine.fcntl, _FCNTLS), (machine.ioctl, _IOCTLS)):
        tests = [line for value in known for line in ((_EQUALS, 0, 1, value), (_RETURN, 0, 0, _ALLOW))]
        lines += _when(number, 1, [*tests, (_RETURN, 0, 0, _EPERM)])
    for number in machine.others:
        lines += [(_EQUALS, 0, 1, number), (_RETURN, 0, 0, _ALLOW)]
    lines.append((_RETURN, 0, 0, _EPERM))
    return b"".join(struct.pack("HBBI", *line) for line in lines)


def _when(number: int, argument: int, block: list[tuple[int, int, int, int]]) -> list[tuple[int, int, int, int]]:
    """The block for one call, which looks at the low half of an argument."""
    body = [(_LOAD, 0, 0, _ARGS + 8 * argument), *block]
    return [(_EQUALS, 0, len(body), number), *body]
