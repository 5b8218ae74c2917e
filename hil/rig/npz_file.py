"""NPZ files that anybody may have written: arrays of numbers, in bounded memory whatever the file says of itself.

An archive of a few kB may say that it holds terabytes, and so may the header of an array in it. Here an array is what
its bytes make it, and the bytes are counted before anything is unfolded.
"""

import io
import math
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from drivers.base.text_file import words_of

MOST_ARRAYS = 256
UNFOLDING = 100  # times its size, which is what numbers can be compressed to, beyond `freely`
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_HEADERS: Mapping[tuple[int, int], Any] = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError, RuntimeError, KeyError, MemoryError)


def read_arrays(file: BinaryIO, freely: int) -> dict[str, NDArray[Any]]:
    """All arrays of an archive by name. freely: bytes that they may take whatever the size of the file.

    Raises ValueError for anything that is no such archive, holds objects, or is too large.
    """
    try:
        folded = file.seek(0, io.SEEK_END)
        with zipfile.ZipFile(file) as archive:
            infos = archive.infolist()
            unfolded = sum(info.file_size for info in infos)
            if len(infos) > MOST_ARRAYS:
                raise ValueError(f"{len(infos)} arrays: at most {MOST_ARRAYS}")
            if unfolded > freely + UNFOLDING * folded:
                raise ValueError(f"its {folded} bytes unfold to {unfolded}")
            if any(info.compress_type not in _METHODS for info in infos):
                raise ValueError("it is compressed by other means than deflate")
            return {info.filename.removesuffix(".npy"): _array(archive.read(info)) for info in infos}
    except _DAMAGED as error:
        raise ValueError(f"no NPZ archive: {error}") from None


def _array(data: bytes) -> NDArray[Any]:
    stream = io.BytesIO(data)
    read_header = _HEADERS.get(npy.read_magic(stream))
    if read_header is None:
        raise ValueError("an array of another version than 1.0 or 2.0")
    try:
        shape, columns_first, dtype = read_header(stream)
    except Exception as error:  # numpy parses Python source there, and says what that says
        raise ValueError(f"an array whose header is damaged: {words_of(error)}") from None
    count, left = math.prod(shape), len(data) - stream.tell()
    if dtype.hasobject or not dtype.itemsize or min(shape, default=0) < 0 or count * dtype.itemsize != left:
        raise ValueError(f"an array of {left} bytes that says to be {dtype} {shape}"[:200])
    array = np.frombuffer(data, dtype, count, stream.tell())
    return array.reshape(shape, order="F" if columns_first else "C").copy(order="K")
