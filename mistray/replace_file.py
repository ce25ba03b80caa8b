"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from mistray.errors import MistrayError


def replace_file(path: str | Path, content: str | bytes, what: str = "file") -> Path:
    """
    Write a file through a draft beside it, so that on an error, or when interrupted, an old file stays as it was.

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
    draft = path.with_name(path.name + ".part")
    try:
        draft.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        os.replace(draft, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)
        raise MistrayError(f"{what} '{path}': {error.strerror}; check the folder and its permissions") from None
    return path
