"""The edit log and the states on disk: what is written comes back, and a line that is cut short is left out."""

import pytest

import warpriver as wr
from warpriver import edits
from warpriver.studio.journal import Entry, Journal, read_journal
from warpriver.studio.reel import Reel

ENTRIES = [
    Entry(0, edits.LockPoint(0, 100.0)),
    Entry(3, edits.MovePoint(0, (0.0, 1.0 / 3.0), (5.0, 6.0), 90.0), "stroke-1"),
    Entry(3, edits.PaintControl(0, (0, 0, 1, 2), (0.1, -2.5e-7)), "stroke-1"),
    Entry(9, edits.RemoveChannel(4)),
]


def test_only_what_is_new_is_written_and_all_comes_back(tmp_path):
    path = tmp_path / "edits.log"
    journal = Journal(path, 5, [], 0)
    journal.note(ENTRIES[:3], 4)
    size = path.stat().st_size
    journal.note(ENTRIES[:3], 4)
    assert path.stat().st_size == size
    journal.note(ENTRIES, 20)
    assert read_journal(path) == (ENTRIES, 5, 20, None)
    journal.note(ENTRIES[:1], 20)  # three are undone
    journal.note([ENTRIES[0], ENTRIES[3]], 21)
    assert read_journal(path) == ([ENTRIES[0], ENTRIES[3]], 5, 21, None)
    assert path.read_bytes().startswith(b'{"format"') and path.stat().st_size > size, "nothing is written anew"
    journal.close()
    again = Journal(path, 5, [ENTRIES[0], ENTRIES[3]], 21)
    again.note([ENTRIES[0]], 21)
    assert read_journal(path)[0] == ENTRIES[:1] or len(read_journal(path)[0]) == 1


def test_a_line_that_is_cut_short_is_left_out_with_a_word(tmp_path):
    path = tmp_path / "edits.log"
    Journal(path, 0, [], 0).note(ENTRIES, 12)
    whole = path.read_bytes()
    for cut in range(len(whole) - 1, whole.rfind(b'{"step":9'), -1):
        path.write_bytes(whole[:cut])
        entries, _, steps, word = read_journal(path)
        assert entries == ENTRIES[: 4 if whole[:cut].count(b"\n") > 4 else 3]
        assert word is None or "cut short" in word
        assert steps >= 3
    for start in (b"", whole[:9]):  # not even the first line is whole
        path.write_bytes(start)
        assert read_journal(path)[:3] == ([], None, 0)
        Journal(path, 7, [], 0).note(ENTRIES, 12)
        assert read_journal(path) == (ENTRIES, 7, 12, None)
    path.write_bytes(whole[:-4])
    journal = Journal(path, 0, *read_journal(path)[0:3:2])
    journal.note(read_journal(path)[0], 30)
    assert read_journal(path) == (ENTRIES, 0, 30, None), "the torn line does not spoil the next one"


@pytest.mark.parametrize("line", [b"[1]", b'{"step": 1, "edit": "Nothing"}', b"\xff", b'{"undo": "x"}'])
def test_a_line_that_is_none_is_told_with_its_number(tmp_path, line):
    path = tmp_path / "edits.log"
    Journal(path, 0, [], 0).note(ENTRIES[:1], 1)
    path.write_bytes(path.read_bytes() + line + b"\n")
    with pytest.raises(wr.WarpriverError, match=r"edits.log, line 4"):
        read_journal(path)


def test_states_are_thinned_evenly_and_rewound(tmp_path, monkeypatch):
    monkeypatch.setattr("warpriver.studio.reel.STATES", 10)
    reel = Reel(tmp_path / "reel")
    for step in range(100):
        if reel.wants(step):
            reel.keep(step, 0.3 * step, b"%d" % step)
    assert reel.steps == list(range(0, 100, 16)) and reel.every == 16
    assert sorted(p.name for p in (tmp_path / "reel").iterdir()) == [f"{s:010d}" for s in reel.steps]
    assert reel.frame(48) == b"48"
    reel.rewind(50)
    assert reel.steps == [0, 16, 32, 48] and reel.last == 48 and len(reel) == 4
    assert not reel.wants(48) and reel.wants(64) and not reel.wants(65)


def test_states_keep_below_their_bytes_and_the_timeline_shows_some(tmp_path, monkeypatch):
    monkeypatch.setattr("warpriver.studio.reel.BYTES", 1000)
    monkeypatch.setattr("warpriver.studio.reel.SHOWN", 4)
    reel = Reel(tmp_path / "reel")
    for step in range(64):
        if reel.wants(step):
            reel.keep(step, float(step), bytes(100))
    assert sum(p.stat().st_size for p in (tmp_path / "reel").iterdir()) <= 1000
    assert reel.shown() == [(0, 0.0), (16, 16.0), (32, 32.0), (48, 48.0)]
