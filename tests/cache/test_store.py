"""The cache on disk: whole entries or none, several processes, damage, limits, disks that do not take anything."""

import errno
import multiprocessing
import os
import random
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from unittest.mock import Mock

import pytest

from mistray.cache import Cache, key_of, store
from mistray.errors import MistrayError

LIMIT = 10_000_000
KEY = key_of({"number": 1})


def content_of(number: int) -> bytes:
    """Content that tells its number in each of its bytes; some of 0, some of several blocks of a disk."""
    return bytes([number % 251]) * (number * 1237 % 40_000)


@pytest.fixture
def cache(tmp_path: Path) -> Cache:
    return Cache(tmp_path / "new" / "cache", LIMIT)


def entry(cache: Cache, key: str = KEY) -> Path:
    return cache.folder / f"{key}.result"


def test_content_comes_back(cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
    for content in (b"", b"\n", b"one", b"two\nlines\n", bytes(range(256)) * 500, b"old"):  # the later one wins
        cache.put(KEY, content)
        assert cache.get(KEY, bytes) == Cache(cache.folder, LIMIT).get(KEY, bytes) == content
        assert [path.name for path in cache.folder.iterdir()] == [f"{KEY}.result"]
    assert cache.problems == []
    with pytest.raises(ValueError, match="not a key of a cache"):
        cache.put("../../elsewhere", b"")
    monkeypatch.setattr(os, "replace", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        cache.put(KEY, b"new")
    assert cache.get(KEY, bytes) == b"old"
    assert len(list(cache.folder.iterdir())) == 1


def test_keys() -> None:
    """Every digit and type counts, the order does not, what has no text is refused."""
    facts = [{"a": 1.0}, {"a": 1.0 + 2**-52}, {"a": 1}, {"a": "1"}, {"a": [1.0]}, {"b": 1.0}, {"a": None}, {}]
    assert len({key_of(one) for one in facts}) == len(facts)
    assert key_of({"a": 1, "b": {"c": 2, "d": 3}}) == key_of({"b": {"d": 3, "c": 2}, "a": 1})
    with pytest.raises(TypeError):
        key_of({"a": object()})


@pytest.mark.parametrize("length", [None, 0, 1, 80, 150])
@pytest.mark.parametrize("place", [0, 5, 20, 90, 150, -1])
def test_damage_is_told_once_and_made_again(cache: Cache, place: int, length: int | None) -> None:
    """A byte is another one, or the end is missing, and half of an entry counts as damage too."""
    cache.put(KEY, b"content of some length, so that all parts of the file are met by a place" * 2)
    data = bytearray(entry(cache).read_bytes())
    data[place] ^= 1
    entry(cache).write_bytes(bytes(data)[:length])
    for _ in range(2):
        assert cache.get(KEY, bytes) is None
        assert len(cache.problems) == 1
    assert f"'{entry(cache)}' is damaged" in cache.problems[0]
    cache.put(KEY, b"again")
    assert cache.get(KEY, bytes) == b"again"
    other = key_of({"number": 2})
    cache.put(other, b"of another key")
    os.replace(entry(cache, other), entry(cache))  # another entry in its place
    assert cache.get(KEY, bytes) is None


class TestDisk:
    refuse = Mock(side_effect=OSError(errno.EROFS, os.strerror(errno.EROFS)))

    def is_told(self, cache: Cache, words: str) -> None:
        for number in range(3):
            cache.put(key_of({"number": number}), b"content")
        assert len(cache.problems) == 1
        assert words in cache.problems[0]
        assert "\n" not in cache.problems[0]
        assert "results are not kept, make room or name another folder in MISTRAY_CACHE" in cache.problems[0]

    @pytest.mark.skipif(not os.path.exists("/dev/full"), reason="the system has no /dev/full")
    @pytest.mark.parametrize("when", ["written", "closed"])
    def test_full(self, cache: Cache, monkeypatch: pytest.MonkeyPatch, when: str) -> None:
        """After a part of the bytes, or only when the buffer is written."""
        real = Path.open

        def full(path: Path, mode: str) -> object:
            if when == "closed":
                return real(Path("/dev/full"), "wb")
            with real(path, mode) as file:
                file.write(b"some")
            return real(Path("/dev/full"), "wb", buffering=0)

        monkeypatch.setattr(Path, "open", full)
        self.is_told(cache, "No space left on device")
        assert list(cache.folder.iterdir()) == []  # no half files

    def test_read_only(self, cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
        """What is there is read; nothing is written. Root may write everywhere, so the refusal is imitated."""
        cache.put(KEY, b"kept")
        before = entry(cache).stat().st_mtime_ns
        monkeypatch.setattr(store.os, "utime", self.refuse)
        assert cache.get(KEY, bytes) == b"kept"
        assert cache.problems == []
        monkeypatch.setattr(Path, "open", self.refuse)
        self.is_told(cache, "Read-only file system")
        monkeypatch.undo()
        assert entry(cache).stat().st_mtime_ns == before
        monkeypatch.setattr(Path, "unlink", self.refuse)
        with pytest.raises(MistrayError, match="Read-only file system; remove it yourself"):
            cache.clear()

    @pytest.mark.parametrize(("name", "words"), [("file/cache", "Not a directory"), ("file", "File exists")])
    def test_a_path_that_cannot_be_a_folder(self, tmp_path: Path, name: str, words: str) -> None:
        (tmp_path / "file").write_text("no folder")
        cache = Cache(tmp_path / name, LIMIT)
        assert cache.get(KEY, bytes) is None
        with pytest.raises(MistrayError, match="Not a directory; check MISTRAY_CACHE"):
            cache.contents()
        self.is_told(cache, words)
        assert (tmp_path / "file").read_text() == "no folder"


class TestSize:
    def test_what_was_not_read_for_longest_goes(self, tmp_path: Path) -> None:
        cache = Cache(tmp_path, 10_000)
        keys = [key_of({"number": number}) for number in range(12)]
        for number, key in enumerate(keys[:8]):
            cache.put(key, b"x" * 850)
            os.utime(entry(cache, key), (1000 + number, 1000 + number))
        assert cache.get(keys[0], bytes) is not None  # read now
        for key in keys[8:]:
            cache.put(key, b"x" * 850)
        there = [entry(cache, key).exists() for key in keys]
        assert cache.contents().size_bytes <= 10_000
        assert there[0]
        gone = there.count(False)
        assert gone > 0
        assert there[1 : 1 + gone] == [False] * gone  # the oldest ones, without a gap
        large = key_of({})
        cache.put(large, b"x" * 50_000)  # one that is too large is kept alone
        assert [entry(cache, key).exists() for key in keys] == [False] * 12
        assert cache.get(large, bytes) == b"x" * 50_000

    def test_files_of_others_stay(self, tmp_path: Path) -> None:
        """But drafts that were left behind go."""
        names = ["thesis.tex", f"{KEY}.txt", "short.result", f"x{KEY}.result", f"{KEY}-new.draft"]
        for name in (*names, f"{KEY}-old.draft"):
            (tmp_path / name).write_bytes(b"half" if name.endswith("draft") else b"x" * 5000)
        os.utime(tmp_path / f"{KEY}-old.draft", (time.time() - 2 * store.OLD_DRAFT_SECONDS,) * 2)
        cache = Cache(tmp_path, 1000)
        for number in range(5):
            cache.put(key_of({"number": number}), b"x" * 400)
        held = cache.contents()
        assert held.entries > 0
        assert held.size_bytes <= 1500
        assert cache.clear().entries == held.entries
        assert cache.contents().entries == 0
        assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)
        assert Cache(tmp_path / "none", LIMIT).clear().entries == 0  # there is no folder


KEYS = 12


def use(folder: str, seed: int, rounds: int) -> tuple[int, int, list[str]]:
    """Read and write some keys in an order of its own; the numbers of hits and of wrong contents, and what was told."""
    order, cache = random.Random(seed), Cache(Path(folder), 120_000)  # less than all have: some go all the time
    hits = wrong = 0
    for _ in range(rounds):
        number = order.randrange(KEYS)
        key = key_of({"number": number})
        found = cache.get(key, bytes)
        if found is None:
            cache.put(key, content_of(number))
        else:
            hits += 1
            wrong += found != content_of(number)
        if order.random() < 0.02:
            cache.clear()
    return hits, wrong, cache.problems


class TestTogether:
    """Several that read, write, remove and clear at once: nobody sees anything half or wrong."""

    def test_processes(self, tmp_path: Path) -> None:
        with multiprocessing.get_context("spawn").Pool(2) as pool:
            results = pool.starmap(use, [(str(tmp_path), seed, 800) for seed in range(2)])
        assert all(hits > 50 and wrong == 0 and problems == [] for hits, wrong, problems in results), results
        assert not [path for path in tmp_path.iterdir() if path.suffix != ".result"]

    def test_threads(self, tmp_path: Path) -> None:
        with ThreadPoolExecutor(4) as pool:
            results = list(pool.map(lambda seed: use(str(tmp_path), seed, 200), range(4)))
        assert all(wrong == 0 and problems == [] for _, wrong, problems in results)
