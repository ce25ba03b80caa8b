#!/usr/bin/env -S uv run --script

# /// script
# dependencies = ["nox>=2025.2.9"]
# ///
"""Quick tests with each supported Python that is installed: ``nox``; with one of them: ``nox -s quick-3.11``.

The supported ones are the classifiers of pyproject.toml. ``make`` is what all else runs by, with one Python.
"""

from __future__ import annotations

import nox

nox.needs_version = ">=2025.2.9"
nox.options.default_venv_backend = "uv|virtualenv"
PROJECT = nox.project.load_toml("pyproject.toml")
TEST = nox.project.dependency_groups(PROJECT, "test")


@nox.session(python=nox.project.python_versions(PROJECT))
def quick(session: nox.Session) -> None:
    """Run a test of every part; arguments after -- replace those of pytest."""
    session.install("-e", ".", *TEST)
    session.run("python", "-m", "pytest", *(session.posargs or ("-m", "quick and not (gpu or slow or long)")))


if __name__ == "__main__":
    nox.main()
