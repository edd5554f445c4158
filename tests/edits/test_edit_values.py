"""Edits as values: what can be told to be wrong without a network, and their way into a file and back."""

import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest

import warpriver as wr
from warpriver import edits
from warpriver.edits.values import edit_of
from warpriver.errors import InputError, InputTypeError

LINE = [(0.0, 0.0), (100.1, 1 / 3), (200.0, -5.0)]
ALL = [
    edits.LockPoint(3, 1234.5),
    edits.AvulseChannel(3, (5.0, 6.0), to=99.5, angle=-20),
    edits.AvulseChannel(3, 99.5),
    edits.DivertChannel(3, (5.0, 6.0), to=4),
    edits.DivertChannel(3, 99.5),
    edits.DivertChannel(3, 99.5, to="outlet"),
    edits.DeferJunction(3),
    edits.CutLoop(3, (5.0, 6.0)),
    edits.CutLoop(3, 99.5, to=(7.0, 1 / 3)),
    wr.meander.SetControls([wr.Attractor((1.0, 2.0), 300.0), wr.DampingRegion(LINE, 0.25), {"kept": 4}]),
    edits.PaintControl(2, (5, 6, 1, 2), [0.5, -3.0]),
    edits.UnlockPoint(3, (1.0, 2.0)),
    edits.MovePoint(3, 10.0, (5.0, -6.0), 300.0),
    edits.SplitChannel(3, 1e3 / 7, width_above=12.0, depth_below=1.5),
    edits.JoinChannels(4, 3),
    edits.AddChannel(LINE, width=20.0, ends="channel", max_rise=2.0),
    edits.RemoveChannel(3),
    edits.RedrawSection(3, LINE),
    edits.SetChannel(3, width=30.0, reach=(100.0, (7.0, 8.0))),
    edits.SetChannel(3, discharge=12.0),
    edits.EditTerrain("raise", center=(1.0, 2.0), radius=100.0, amount=5.0),
    edits.EditTerrain("flatten", center=(1.0, 2.0), radius=100.0, amount=0.5, level=3.0),
    edits.EditTerrain("ridge", line=LINE, height=(1.0, 2.0, 3.0), width=50.0),
]


def test_every_kind_is_tried():
    assert {edit.name for edit in ALL} == {"SetControls", *edits.__all__} - {
        "Edit",
        "Session",
        "read_edits",
        "write_edits",
    }


@pytest.mark.parametrize("edit", ALL, ids=lambda edit: edit.name)
def test_an_edit_comes_back_from_json_as_it_was(edit):
    again = edit_of(json.loads(json.dumps(edit.as_json())))
    assert again == edit and hash(again) == hash(edit)
    with pytest.raises(dataclasses.FrozenInstanceError):
        edit.channel = 5


def test_a_session_comes_back_from_its_file(tmp_path):
    pairs = [(10 * k, edit) for k, edit in enumerate(ALL)]
    edits.write_edits(tmp_path / "session.json", pairs, seed=7, steps=500)
    session = edits.read_edits(tmp_path / "session.json")
    assert session == edits.Session(tuple(pairs), seed=7, steps=500)
    # One edit a line, to be read and compared.
    assert (tmp_path / "session.json").read_text().count("\n") == len(ALL) + 2
    edits.write_edits(tmp_path / "empty.json", [])
    assert edits.read_edits(tmp_path / "empty.json") == edits.Session(())


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: edits.LockPoint(-1, 0.0), "channel is -1"),
        (lambda: edits.LockPoint(1.5, 0.0), "channel is 1.5"),
        (lambda: edits.LockPoint(1, -3.0), r"at is -3; .*m, 0 or more from the head of the channel, or a point"),
        (lambda: edits.LockPoint(1, (3.0, np.nan)), "at is .*2 finite numbers"),
        (lambda: edits.LockPoint(1, "mouth"), "at is 'mouth'"),
        (lambda: edits.MovePoint(1, 0.0, (1.0, 2.0), 0.0), "radius is 0; give a positive number of m"),
        (lambda: edits.MovePoint(1, 0.0, (1.0, np.inf), 5.0), "to is .*finite"),
        (lambda: edits.SplitChannel(1, 0.0, width_below=-3.0), "width_below is -3; give a positive number of m"),
        (lambda: edits.AddChannel(LINE, width=-20.0), "width is -20; give a positive number of m"),
        (lambda: edits.AddChannel(LINE[:1], width=20.0), "xy has 1 points; give at least 2"),
        (lambda: edits.AddChannel([LINE[0], LINE[0], LINE[1]], width=20.0), "xy: points 0 and 1 are both"),
        (lambda: edits.AddChannel(LINE, width=20.0, ends="sea"), "ends is 'sea'; use 'any', 'channel' or 'outlet'"),
        (lambda: edits.SetChannel(1), "sets nothing; give width, depth or discharge"),
        (lambda: edits.SetChannel(1, width=0.0), "width is 0"),
        (lambda: edits.SetChannel(1, discharge=3.0, reach=(0.0, 5.0)), "discharge cannot be set in a reach"),
        (lambda: edits.SetChannel(1, width=3.0, reach=5.0), "reach is 5; give two places"),
        (lambda: edits.EditTerrain("dig", (0.0, 0.0), 5.0, 1.0), "operation is 'dig'; use 'raise'"),
        (
            lambda: edits.EditTerrain("raise", (0.0, 0.0), 5.0),
            "amount is missing; to raise give center, radius, ",
        ),
        (lambda: edits.EditTerrain("raise", (0.0, 0.0), 5.0, 1.0, 2.0), "only flatten goes to one"),
        (lambda: edits.EditTerrain("raise", (0.0, 0.0), 5.0, 1.0, width=2.0), "width is given, which raise does not"),
        (lambda: edits.EditTerrain("smooth", (0.0, 0.0), 5.0, 2.0), "give a fraction, 0 to 1"),
        (lambda: edits.EditTerrain("ridge", line=LINE, height=(1.0, 2.0), width=5.0), "height is .*give 3 finite"),
        (lambda: edits.Session(((5, ALL[0]), (3, ALL[1]))), "give the edits in the order"),
        (lambda: edits.Session(((5, "lock"),)), "'lock' is no edit"),
        (lambda: edit_of({"edit": "Dig"}), "there is no edit 'Dig'; there are AddChannel, "),
        (lambda: edit_of({"edit": "RemoveChannel", "reach": 3}), "RemoveChannel has no 'reach'; it has channel"),
        (lambda: edit_of({"edit": "RemoveChannel"}), "RemoveChannel lacks a field"),
        (lambda: edit_of([1]), "is no edit"),
    ],
)
def test_what_is_wrong_is_told(make, words):
    with pytest.raises(InputError, match=words) as told:
        make()
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("words", "is no session: it is no JSON"),
        ("[]", "it needs the format 'warpriver-edits-1'"),
        ('{"format": "warpriver-edits-1", "edits": [3]}', "edit 0: "),
        ('{"format": "warpriver-edits-1", "edits": [{"edit": "RemoveChannel", "channel": 1}]}', "edit 0: step is None"),
        ('{"format": "warpriver-edits-1", "seed": -1, "edits": []}', "seed is -1"),
    ],
)
def test_a_file_that_is_no_session_is_refused(text, words, tmp_path):
    (tmp_path / "session.json").write_text(text)
    with pytest.raises(InputError, match=words) as told:
        edits.read_edits(tmp_path / "session.json")
    assert "session.json" in str(told.value)
    with pytest.raises(FileNotFoundError, match="no session at"):
        edits.read_edits(tmp_path / "missing.json")


def test_two_kinds_cannot_have_one_name():
    with pytest.raises(InputTypeError, match="both have an edit RemoveChannel"):
        type("RemoveChannel", (edits.Edit,), {"__module__": "elsewhere"})
    assert wr.edits is edits


def test_a_session_with_controls_is_read_by_a_program_that_uses_nothing_else(tmp_path):
    """Edits of controls are at home in another room, which nobody has imported yet."""
    path = tmp_path / "edits.json"
    wr.edits.write_edits(path, [(0, wr.meander.SetControls(wr.Attractor(center=(0.0, 0.0))))])
    script = f"import warpriver as wr; print(wr.edits.read_edits({str(path)!r}).edits[0][1].name)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.stdout.strip().splitlines()[-1:] == ["SetControls"], done.stderr
