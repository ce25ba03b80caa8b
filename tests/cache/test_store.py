"""The cache on disk: whole entries or none, several processes, damage, limits, disks that do not take anything."""

from __future__ import annotations

import errno
import multiprocessing
import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

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


class TestContent:
    @pytest.mark.parametrize("content", [b"", b"\n", b"one", b"two\nlines\n", bytes(range(256)) * 500])
    def test_comes_back(self, cache: Cache, content: bytes) -> None:
        assert cache.get(KEY, bytes) is None
        cache.put(KEY, content)
        assert cache.get(KEY, bytes) == content
        assert Cache(cache.folder, LIMIT).get(KEY, bytes) == content
        assert cache.problems == []
        assert [path.name for path in cache.folder.iterdir()] == [f"{KEY}.result"]

    def test_the_later_one_wins(self, cache: Cache) -> None:
        for content in (b"first", b"second"):
            cache.put(KEY, content)
        assert cache.get(KEY, bytes) == b"second"
        assert cache.contents().entries == 1

    def test_a_key_is_no_path(self, cache: Cache) -> None:
        with pytest.raises(ValueError, match="no key of a cache"):
            cache.put("../../elsewhere", b"")

    def test_interrupted_while_writing(self, cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
        cache.put(KEY, b"old")

        def interrupted(*_: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(os, "replace", interrupted)
        with pytest.raises(KeyboardInterrupt):
            cache.put(KEY, b"new")
        assert cache.get(KEY, bytes) == b"old"
        assert len(list(cache.folder.iterdir())) == 1


class TestKeys:
    def test_every_digit_and_type_counts(self) -> None:
        facts = [{"a": 1.0}, {"a": 1.0 + 2**-52}, {"a": 1}, {"a": "1"}, {"a": [1.0]}, {"b": 1.0}, {"a": None}, {}]
        assert len({key_of(one) for one in facts}) == len(facts)

    def test_the_order_does_not(self) -> None:
        assert key_of({"a": 1, "b": {"c": 2, "d": 3}}) == key_of({"b": {"d": 3, "c": 2}, "a": 1})

    def test_what_has_no_text_is_refused(self) -> None:
        with pytest.raises(TypeError):
            key_of({"a": object()})


class TestDamage:
    @pytest.mark.parametrize("place", [0, 5, 20, 90, 150, -1])
    def test_any_byte(self, cache: Cache, place: int) -> None:
        cache.put(KEY, b"content of some length, so that all parts of the file are met by a place" * 2)
        data = bytearray(entry(cache).read_bytes())
        data[place] ^= 1
        entry(cache).write_bytes(bytes(data))
        self.is_told_once_and_made_again(cache)

    @pytest.mark.parametrize("length", [0, 1, 80, 150])
    def test_the_end_is_missing(self, cache: Cache, length: int) -> None:
        cache.put(KEY, b"content" * 10)
        entry(cache).write_bytes(entry(cache).read_bytes()[:length])
        self.is_told_once_and_made_again(cache)

    def test_another_entry_in_its_place(self, cache: Cache) -> None:
        other = key_of({"number": 2})
        cache.put(other, b"of another key")
        os.replace(entry(cache, other), entry(cache))
        self.is_told_once_and_made_again(cache)

    def is_told_once_and_made_again(self, cache: Cache) -> None:
        assert cache.get(KEY, bytes) is None
        assert len(cache.problems) == 1
        assert f"'{entry(cache)}' is damaged" in cache.problems[0]
        assert cache.get(KEY, bytes) is None
        assert len(cache.problems) == 1
        cache.put(KEY, b"again")
        assert cache.get(KEY, bytes) == b"again"


class TestDisk:
    def is_told(self, cache: Cache, words: str) -> None:
        for number in range(3):
            cache.put(key_of({"number": number}), b"content")
        assert len(cache.problems) == 1
        assert words in cache.problems[0]
        assert "\n" not in cache.problems[0]
        assert "results are not kept, make room or name another folder in MISTRAY_CACHE" in cache.problems[0]

    def test_full_when_written(self, cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
        """After a part of the bytes."""
        real = Path.open

        def full(path: Path, mode: str) -> object:
            with real(path, mode) as file:
                file.write(b"some")
            return real(Path("/dev/full"), "wb", buffering=0)

        if not os.path.exists("/dev/full"):
            pytest.skip("the system has no /dev/full")
        monkeypatch.setattr(Path, "open", full)
        self.is_told(cache, "No space left on device")
        assert list(cache.folder.iterdir()) == []  # no half files

    @pytest.mark.skipif(not os.path.exists("/dev/full"), reason="the system has no /dev/full")
    def test_full_when_closed(self, cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
        """A disk that says so only when the buffer is written."""
        real = Path.open
        monkeypatch.setattr(Path, "open", lambda *_: real(Path("/dev/full"), "wb"))
        self.is_told(cache, "No space left on device")

    def test_read_only(self, cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
        """What is there is read; nothing is written. Root may write everywhere, so the refusal is imitated."""
        cache.put(KEY, b"kept")
        before = entry(cache).stat().st_mtime_ns

        def refuse(*_: object, **__: object) -> None:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))

        monkeypatch.setattr(store.os, "utime", refuse)
        assert cache.get(KEY, bytes) == b"kept"
        assert cache.problems == []
        monkeypatch.setattr(Path, "open", refuse)
        self.is_told(cache, "Read-only file system")
        monkeypatch.undo()
        assert entry(cache).stat().st_mtime_ns == before

    def test_a_path_below_a_file(self, tmp_path: Path) -> None:
        file = tmp_path / "file"
        file.write_text("no folder")
        cache = Cache(file / "cache", LIMIT)
        assert cache.get(KEY, bytes) is None
        with pytest.raises(MistrayError, match="Not a directory; check MISTRAY_CACHE"):
            cache.contents()
        self.is_told(cache, "Not a directory")
        assert file.read_text() == "no folder"

    def test_a_path_that_is_a_file(self, tmp_path: Path) -> None:
        file = tmp_path / "file"
        file.write_text("no folder")
        cache = Cache(file, LIMIT)
        assert cache.get(KEY, bytes) is None
        self.is_told(cache, "File exists")


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
        assert all(there[8:])
        gone = there.index(False), len(there) - 1 - there[::-1].index(False)
        assert gone[0] == 1
        assert not any(there[gone[0] : gone[1] + 1])  # the oldest ones, without a gap

    def test_one_that_is_too_large_is_kept_alone(self, tmp_path: Path) -> None:
        cache = Cache(tmp_path, 1000)
        other = key_of({})
        cache.put(other, b"small")
        cache.put(KEY, b"x" * 5000)
        assert cache.get(KEY, bytes) == b"x" * 5000
        assert cache.get(other, bytes) is None

    def test_files_of_others_stay(self, tmp_path: Path) -> None:
        names = ["thesis.tex", f"{KEY}.txt", "short.result", f"x{KEY}.result"]
        for name in names:
            (tmp_path / name).write_bytes(b"x" * 5000)
        cache = Cache(tmp_path, 1000)
        for number in range(5):
            cache.put(key_of({"number": number}), b"x" * 400)
        assert cache.contents().size_bytes <= 1500
        cache.clear()
        assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)

    def test_drafts_that_were_left_behind(self, tmp_path: Path) -> None:
        drafts = [tmp_path / f"{KEY}-{name}.draft" for name in ("old", "new")]
        for draft in drafts:
            draft.write_bytes(b"half")
        os.utime(drafts[0], (time.time() - 2 * store.OLD_DRAFT_SECONDS,) * 2)
        Cache(tmp_path, LIMIT).put(KEY, b"content")
        assert [draft.exists() for draft in drafts] == [False, True]

    def test_clear(self, cache: Cache) -> None:
        assert cache.clear().entries == 0  # there is no folder yet
        for number in range(3):
            cache.put(key_of({"number": number}), b"x" * 100)
        held = cache.contents()
        assert held.entries == 3
        assert cache.clear() == held
        assert cache.contents().entries == 0

    def test_an_entry_that_cannot_be_removed(self, cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
        cache.put(KEY, b"content")

        def refuse(*_: object, **__: object) -> None:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))

        monkeypatch.setattr(Path, "unlink", refuse)
        with pytest.raises(MistrayError, match="Read-only file system; remove it yourself"):
            cache.clear()


KEYS = 12


def use(folder: str, seed: int, rounds: int) -> tuple[int, int, list[str]]:
    """Read and write some keys in an order of its own; the numbers of hits and of wrong contents, and what was told."""
    import random

    order = random.Random(seed)
    cache = Cache(Path(folder), 120_000)  # less than all of them have: entries are removed all the time
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
    def test_processes(self, tmp_path: Path) -> None:
        """Two that read, write, remove and clear at once: nobody sees anything half or wrong."""
        with multiprocessing.get_context("spawn").Pool(2) as pool:
            results = pool.starmap(use, [(str(tmp_path), seed, 800) for seed in range(2)])
        for hits, wrong, problems in results:
            assert hits > 50
            assert wrong == 0
            assert problems == []
        assert not [path for path in tmp_path.iterdir() if path.suffix != ".result"]

    def test_threads(self, tmp_path: Path) -> None:
        with ThreadPoolExecutor(4) as pool:
            results = list(pool.map(lambda seed: use(str(tmp_path), seed, 200), range(4)))
        assert all(wrong == 0 and problems == [] for _, wrong, problems in results)

    def test_a_writer_that_does_not_rename_would_be_seen(self, tmp_path: Path) -> None:
        """What the processes' test is for: half of an entry counts as damage, never as content."""
        cache = Cache(tmp_path, LIMIT)
        cache.put(KEY, content_of(5))
        whole = entry(cache).read_bytes()
        entry(cache).write_bytes(whole[: len(whole) // 2])
        assert cache.get(KEY, bytes) is None
        assert cache.problems
