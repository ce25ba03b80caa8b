"""Command `mistray cache`, which reports on the cache of results or clears it."""

from __future__ import annotations

from typing import Any

from mistray.cli.parsed_options import Options
from mistray.toolkit.command import Command, Option

BYTES_PER_MB = 1e6


# fmt: off
COMMAND = Command(
    "cache",
    "say what is kept of earlier results, or remove it",
    "Results of mistray sweep are kept in the user's folder for caches, or in that of the environment\n"
    "variable MISTRAY_CACHE (off: none), up to MISTRAY_CACHE_MB (1000); docs/sweeps.md has the details.",
    (
        "mistray cache info", "mistray cache clear",
    ),
    (
        Option("action", "say where the cache is and how large, or remove all results", ("info", "clear")),
        Option("--json", "print JSON instead of text", bool),
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Print what the cache holds, or clear it and print what was removed; return the exit code 0."""
    from mistray.cache import limit_bytes, open_cache

    cache = open_cache()
    if cache is None:
        record: dict[str, Any] = {"folder": None, "entries": 0, "size_bytes": 0, "limit_bytes": limit_bytes()}
        text = "the cache is switched off by MISTRAY_CACHE"
    else:
        found = cache.clear() if options.action == "clear" else cache.contents()
        record = {
            "folder": str(cache.folder),
            "entries": found.entries,
            "size_bytes": found.size_bytes,
            "limit_bytes": cache.limit_bytes,
        }
        done = "removed" if options.action == "clear" else "holds"
        text = (
            f"{cache.folder}: {done} {found.entries} results, {found.size_bytes / BYTES_PER_MB:.3g} of "
            f"{cache.limit_bytes / BYTES_PER_MB:g} MB"
        )
    return options.say(lambda: {"action": options.action, **record}, lambda: text)
