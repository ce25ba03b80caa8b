"""Caches of results, on disk and in memory: folder, keys and storage."""

from mistray.cache.fingerprint import code_fingerprint, file_fingerprint, key_of
from mistray.cache.folder import default_folder, limit_bytes, open_cache
from mistray.cache.kept_results import kept
from mistray.cache.store import Cache, Contents

__all__ = [
    "Cache",
    "Contents",
    "code_fingerprint",
    "default_folder",
    "file_fingerprint",
    "kept",
    "key_of",
    "limit_bytes",
    "open_cache",
]


def __dir__() -> list[str]:
    return sorted(__all__)
