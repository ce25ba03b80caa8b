"""Clouds of particles from the cache are those that would be computed."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mistray.physics import contamination
from mistray.scatter import particle_clouds
from mistray.scatter.particle_clouds import kept_cloud

SMALL = (0.55, 1.53 + 0.002j, 2.0, 0.926, 1.0, None, 1.0)  # few sizes: quick
ANGLES = np.array([0.0, 1e-4, 0.01, 0.3, 1.5, 3.0, np.pi])


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MISTRAY_CACHE", str(tmp_path / "cache"))
    _forget()
    return tmp_path / "cache"


def _forget() -> None:
    """As another process: nothing is in memory."""
    for function in (kept_cloud, particle_clouds._cache, contamination.cloud):
        function.cache_clear()


def _computed(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    done: list[Any] = []
    real = particle_clouds.cloud
    monkeypatch.setattr(particle_clouds, "cloud", lambda *arguments: done.append(arguments) or real(*arguments))
    return done


def test_the_same_numbers(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = _computed(monkeypatch)
    expected = contamination.cloud(*SMALL)
    for _ in range(2):
        found = kept_cloud(*SMALL)
        assert (found.extinction, found.scattering) == (expected.extinction, expected.scattering)
        np.testing.assert_allclose(found.f(ANGLES), expected.f(ANGLES), rtol=1e-13)
        _forget()
    assert len(done) == 1
    assert len(list(folder.iterdir())) == 1


@pytest.mark.parametrize("place", range(7))
def test_every_argument_counts(place: int, monkeypatch: pytest.MonkeyPatch) -> None:
    other = list(SMALL)
    other[place] = 1.5 if SMALL[place] is None else SMALL[place] * (1 + 1e-9)
    made = contamination.cloud(*SMALL)
    done: list[Any] = []
    monkeypatch.setattr(particle_clouds, "cloud", lambda *arguments: done.append(arguments) or made)
    kept_cloud(*SMALL)
    kept_cloud(*other)
    assert done == [SMALL, tuple(other)]


@pytest.mark.parametrize("content", [None, b"null", b"{}", b"[1, 1, []]", b"[1, 2, [0]]", b"[NaN, 0, [0]]", b"\xff"])
def test_another_form(folder: Path, caplog: pytest.LogCaptureFixture, content: bytes | None) -> None:
    """Also a file that is cut."""
    before = kept_cloud(*SMALL)
    (path,) = folder.iterdir()
    magic, key, _, _ = path.read_bytes().split(b"\n", 3)
    if content is None:
        path.write_bytes(path.read_bytes()[:-30])
    else:
        path.write_bytes(b"\n".join((magic, key, hashlib.sha256(content).hexdigest().encode(), content)))
    _forget()
    assert kept_cloud(*SMALL).extinction == before.extinction
    assert [f"'{path}' is damaged" in record.getMessage() for record in caplog.records] == [True]
