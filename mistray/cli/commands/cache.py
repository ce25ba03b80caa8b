"""`mistray cache`."""

from __future__ import annotations

import argparse
from typing import Any

from mistray.cli.arguments import Help
from mistray.cli.tracing_arguments import print_json

BYTES_PER_MB = 1e6


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "cache",
        help="say what is kept of earlier results, or remove it",
        description="Results of mistray sweep are kept in the user's folder for caches, or in that of the environment\n"
        "variable MISTRAY_CACHE (off: none), up to MISTRAY_CACHE_MB (1000); docs/sweeps.md has the details.",
        epilog="examples:\n  mistray cache info\n  mistray cache clear",
        formatter_class=Help,
    )
    parser.add_argument(
        "action", choices=("info", "clear"), help="say where the cache is and how large, or remove all results"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of text")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
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
    if options.json:
        print_json({"action": options.action, **record})
    else:
        print(text)
    return 0
