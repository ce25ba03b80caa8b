"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path

from mistray.errors import MistrayError


def replace_file(path: str | Path, content: str | bytes, what: str = "file") -> Path:
    """
    Write a file through a draft beside it, so that on an error, or when interrupted, an old file stays as it was.

    The draft has a name of its own: of two processes that write the same file one comes last, and either is whole. What
    is no file, such as /dev/stdout, is written to as it is.

    Parameters
    ----------
    path : str or Path
    content : str or bytes
        Text is written as UTF-8.
    what : str
        Kind of file, for the message.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    MistrayError
        If it cannot be written.
    """
    path = Path(path)
    data = content.encode("utf-8") if isinstance(content, str) else content
    draft = path.with_name(f".{secrets.token_hex(4)}.part")
    try:
        if os.path.isdir(path):
            raise MistrayError(f"{what} '{path}' is a folder; name a file")
        if os.path.exists(path) and not os.path.isfile(path):
            path.write_bytes(data)
            return path
        try:
            draft.write_bytes(data)
            os.replace(draft, path)
        except BaseException:
            with contextlib.suppress(OSError):
                draft.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise MistrayError(
            f"{what} '{path}': {error.strerror}; check the folder and its permissions, or choose another"
        ) from None
    return path
