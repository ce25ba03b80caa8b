"""Where the cache is, how large it may be, and what its keys depend on."""

import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from mistray.cache import code_fingerprint, default_folder, file_fingerprint, fingerprint, limit_bytes, open_cache
from mistray.errors import MistrayError

pytestmark = pytest.mark.quick


def test_the_environment_says_where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MISTRAY_CACHE", str(tmp_path))
    assert default_folder() == tmp_path
    for given, folder in ((None, tmp_path), (tmp_path / "other", tmp_path / "other")):
        cache = open_cache(given)
        assert cache is not None
        assert cache.folder == folder
    assert open_cache(False) is None
    for word in ("off", "OFF", "0"):
        monkeypatch.setenv("MISTRAY_CACHE", word)
        assert default_folder() is open_cache() is open_cache(True) is None


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="folders of Linux")
def test_the_users_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MISTRAY_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_folder() == tmp_path / "mistray"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_folder() == tmp_path / ".cache" / "mistray"
    monkeypatch.setattr(Path, "home", Mock(side_effect=RuntimeError("Could not determine home directory.")))
    with pytest.raises(MistrayError, match="no home folder for a cache; set MISTRAY_CACHE to a folder, or to 'off'"):
        open_cache()


def test_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    assert limit_bytes() == 1_000_000_000
    monkeypatch.setenv("MISTRAY_CACHE_MB", "2.5")
    assert limit_bytes() == 2_500_000
    for wrong in ("0", "-1", "much", "nan", "inf"):
        monkeypatch.setenv("MISTRAY_CACHE_MB", wrong)
        with pytest.raises(MistrayError, match=f"MISTRAY_CACHE_MB is '{wrong}'; give the size"):
            limit_bytes()
    with pytest.raises(MistrayError, match="No such file"):
        file_fingerprint(Path("nowhere"))


def test_code_and_versions_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "package"
    for name in ("trace", "files", "cli"):
        (package / name).mkdir(parents=True)
        (package / name / "part.py").write_text("x = 1\n")
    (package / "trace" / "table.csv").write_text("1\n")
    (package / "trace" / "notes.txt").write_text("1\n")

    def now(version: str = "1") -> str:
        code_fingerprint.cache_clear()
        with monkeypatch.context() as patched:
            spec = type("Spec", (), {"submodule_search_locations": [str(package)]})
            patched.setattr(fingerprint.importlib.util, "find_spec", lambda _: spec)
            patched.setattr(fingerprint.importlib.metadata, "version", lambda _: version)
            return code_fingerprint()

    try:
        before = now()
        assert now() == before
        assert now("2") != before
        (package / "cli" / "part.py").write_text("x = 2\n")  # shows numbers and makes none
        (package / "trace" / "notes.txt").write_text("2\n")
        assert now() == before
        for name in ("trace/part.py", "trace/table.csv", "files/part.py"):  # files has readers of inputs
            (package / name).write_text("x = 2\n")
            assert now() != before
            before = now()
        (package / "trace" / "new.py").write_text("")
        assert now() != before
    finally:
        code_fingerprint.cache_clear()
