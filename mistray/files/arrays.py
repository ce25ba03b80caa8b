"""Check of the memory that a NumPy file, ``.npz`` or ``.npy``, would take, before it is loaded."""

from __future__ import annotations

import io
import math
import zipfile
from typing import IO

import numpy as np

from mistray.errors import MistrayError

GIB = 1 << 30


def check_arrays(data: bytes, most: int) -> io.BytesIO:
    """
    Return the content of a NumPy file as a stream, if it is neither too large in memory nor shorter than it claims.

    A few kilobytes of an archive may unpack to gigabytes, and NumPy allocates an array before it reads it.

    Parameters
    ----------
    data : bytes
        Content of the file.
    most : int
        Largest unpacked size, bytes.

    Returns
    -------
    io.BytesIO
        Content as a stream, for ``np.load(…, allow_pickle=False)``.

    Raises
    ------
    MistrayError
        If it is too large or too short; the message does not name the file.
    ValueError, EOFError, zipfile.BadZipFile
        If it is not a NumPy file.
    """
    stream = io.BytesIO(data)
    if not zipfile.is_zipfile(stream):
        stream.seek(0)
        _check_array(stream, len(data), most)
    else:
        with zipfile.ZipFile(stream) as archive:
            if (size := sum(entry.file_size for entry in archive.infolist())) > most:
                raise _too_large(size, most)
            for entry in archive.infolist():
                with archive.open(entry) as array:
                    _check_array(array, entry.file_size, most)
    stream.seek(0)
    return stream


def _check_array(array: IO[bytes], size: int, most: int) -> None:
    """Raise `MistrayError` if an array in a file claims more bytes than allowed, `most`, or than its `size`."""
    version = np.lib.format.read_magic(array)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, kind = read_header(array)
    claimed = math.prod(shape) * kind.itemsize
    if claimed > most:
        raise _too_large(claimed, most)
    if not kind.hasobject and claimed > size:
        raise MistrayError(f"an array of it has {claimed} bytes by its header, and {size} in the file; make it again")


def _too_large(size: int, most: int) -> MistrayError:
    return MistrayError(
        f"it would unpack to {size / GIB:.3g} GiB, more than {most / GIB:.3g} GiB; make it again, smaller"
    )
