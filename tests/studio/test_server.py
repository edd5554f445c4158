"""The server: who is let in, what is refused, and what a session outlives: bad messages, many pages, a dead process."""

import contextlib
import http.client
import itertools
import json
import os
import random
import signal
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

import warpriver as wr
from warpriver.studio.folder import begin_folder
from warpriver.studio.generators import generated
from warpriver.studio.opening import unpack_session


def get(served, path, method="GET", body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=60)
    given = {"Host": f"127.0.0.1:{served.port}"} | {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, body, given)
    answer = connection.getresponse()
    return answer.status, dict(answer.getheaders()), answer.read()


def cookie(served):
    return f"warpriver_studio={served.token}"


def test_the_link_opens_the_page_and_nothing_else_does(served):
    status, headers, body = get(served, f"/?token={served.token}")
    assert status == 200 and b"warpriver studio" in body
    assert "HttpOnly" in headers["set-cookie"] and "SameSite=Strict" in headers["set-cookie"]
    policy = headers["content-security-policy"]
    assert "script-src 'self';" in policy and "unsafe" not in policy and "frame-ancestors 'none'" in policy
    assert get(served, "/", Cookie=cookie(served))[0] == 200
    for path, given in (
        ("/", {}),
        ("/?token=wrong", {}),
        (f"/?token={served.token[:-1]}", {}),
        ("/", {"Cookie": "warpriver_studio="}),
        ("/static/main.js", {}),
        ("/exports/rivers.gpkg", {"Cookie": "other=1"}),
    ):
        assert get(served, path, **given)[0] == 401, path


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "", "[::2]", "localhost.evil"]
)
def test_another_name_is_refused(served, page, host):
    assert get(served, f"/?token={served.token}", Host=host)[0] == 421
    with pytest.raises((InvalidStatus, ConnectionClosed)):
        page(Host=host or "x")


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1", "http://127.0.0.1:1"])
def test_another_page_is_refused(served, page, origin):
    with pytest.raises((InvalidStatus, ConnectionClosed)):
        page(Origin=origin)
    answer = get(served, "/open/a.csv", "PUT", b"x", Cookie=cookie(served), Origin=origin)
    assert answer[0] == 403


def test_a_socket_needs_origin_and_token(served):
    address = f"ws://127.0.0.1:{served.port}/live"
    for given in ({}, {"Cookie": cookie(served)}, {"Origin": f"http://127.0.0.1:{served.port}"}):
        with pytest.raises((InvalidStatus, ConnectionClosed)):
            connect(address, additional_headers=given)


@pytest.mark.parametrize(
    "path",
    ["/static/../app.py", "/static/%2e%2e/app.py", "/static/..%2f..%2fapp.py", "/exports/..%2frun%2fheader.json",
     "/exports/%2e%2e%2fedits.log", "/exports//etc/passwd", "/static//etc/passwd"],
)  # fmt: skip
def test_no_path_leads_out(served, path):
    status, _, body = get(served, path, Cookie=cookie(served))
    assert status in (400, 404, 405), path
    assert b"import" not in body and b"root:" not in body


def test_uploads_have_a_limit_and_a_plain_name(served):
    ours = {"Cookie": cookie(served), "Origin": f"http://127.0.0.1:{served.port}"}
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=60)
    connection.putrequest("PUT", "/open/a.tif")
    for name, value in (ours | {"Content-Length": str(2**30)}).items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    assert answer.status == 413 and b"256 MiB" in answer.read()
    assert get(served, "/open/..%2fa.tif", "PUT", b"x", **ours)[0] in (400, 404)
    assert get(served, "/open/.hidden", "PUT", b"x", **ours)[0] == 400


def test_a_bad_file_is_told_and_the_session_stays(served, page):
    ours = {"Cookie": cookie(served), "Origin": f"http://127.0.0.1:{served.port}"}
    talk = page()
    talk.until(lambda t: t.state is not None)
    points = talk.state.point_xy.tobytes()
    status, _, body = get(served, "/open/a.csv", "PUT", b"x,y\n1,nonsense\n", **ours)
    assert status == 422 and body.startswith(b"a.csv") and b"/" not in body.split(b":")[0]
    assert get(served, "/open/a.exe", "PUT", b"x", **ours)[0] == 422
    again = page()
    again.until(lambda t: t.state is not None)
    assert again.state.point_xy.tobytes() == points


def test_commands_are_answered_and_errors_told(served, page):
    talk = page()
    talk.until(lambda t: t.state is not None and "scene" in t.told)
    origin, step = np.array(talk.told["scene"]["origin"]), talk.state.step
    assert "error" not in talk.ask("step", count=3)
    talk.until(lambda t: t.state.step == step + 3)
    channel, place = int(talk.state.channel_id[0]), talk.state.point_xy[20] + origin
    edit = {
        "edit": "MovePoint",
        "channel": channel,
        "at": place.tolist(),
        "to": (place + 60.0).tolist(),
        "radius": 500.0,
    }
    before = talk.state.point_xy.copy()
    assert "error" not in talk.ask("edit", edit=edit)
    talk.until(
        lambda t: (
            t.told["session"]["undo"] == 1 and len(t.state.point_xy) and not np.array_equal(t.state.point_xy, before)
        )
    )
    assert "error" not in talk.ask("undo")
    talk.until(lambda t: np.array_equal(t.state.point_xy, before))
    assert "there is no edit to undo" in talk.ask("undo")["error"]
    for what, rest, words in (
        ("edit", {"edit": edit | {"channel": 999}}, "999"),
        ("edit", {"edit": {"edit": "Nothing"}}, "there is no edit 'Nothing'"),
        ("edit", {}, "edit has wrong arguments"),
        ("step", {"number_of": 3}, "it takes count"),
        ("step", {"count": 10**9}, "1 to 10,000"),
        ("play", {"rate": -1}, "0.1 to 240"),
        ("dance", {}, "there is no command 'dance'"),
        ("params", {"friction": -1.0}, "friction"),
        ("export", {"name": "../x"}, "there is no export"),
        ("open_saved", {"saved": "../run"}, "was saved here"),
        ("record", {"index": 10**6}, "the timeline has"),
        ("paint", {"center": [0, 0], "radius": "x", "amount": 1}, "radius"),
    ):
        assert words in talk.ask(what, **rest)["error"], what


def test_messages_at_random_do_no_harm(served, page):
    rng = random.Random(0)
    talk = page()
    talk.until(lambda t: t.state is not None)
    good = json.dumps(
        {"number": 1, "do": "edit", "edit": {"edit": "MovePoint", "channel": 0, "at": 3, "to": [1, 2], "radius": 9}}
    )
    for k in range(1000):
        text = list(good)
        for _ in range(rng.randrange(1, 6)):
            text[rng.randrange(len(text))] = chr(rng.randrange(1, 0x2FF))
        sent = "".join(text)[: rng.randrange(len(text))] if k % 3 else "".join(text)
        if k % 50 == 0:
            sent = "[" * 5000 if k % 100 else json.dumps({"number": 5, "do": {"a": [k]}, "count": None})
        talk.socket.send(sent)
    talk.numbers = itertools.count(100_000)
    end = talk.ask("step")
    assert "error" not in end or "too many" in end["error"]
    again = page()
    assert "error" not in again.ask("step")


def test_binary_and_oversized_messages_close_the_socket(served, page):
    for message in (b"\1\2\3", "x" * (2**20 + 100)):
        talk = page()
        with pytest.raises(ConnectionClosed):
            talk.socket.send(message)
            for _ in range(10_000):
                talk.socket.recv(timeout=30)


def test_many_pages_at_once(served, page):
    """Fifty: as many as there is room for see the session, the others are told."""
    pages, refused = [], 0
    for _ in range(50):
        talk = page()
        try:
            talk.until(lambda t: "scene" in t.told)
            pages.append(talk)
        except ConnectionClosed:
            refused += 1
    assert len(pages) == 32 and refused == 18
    pages[0].until(lambda t: t.state is not None)
    step = pages[0].state.step + 1
    assert "error" not in pages[0].ask("step")
    for talk in pages:
        talk.until(lambda t: t.state is not None and t.state.step >= step)
    for talk in pages:
        talk.close()


def test_a_page_that_takes_nothing_holds_nobody_up(served, page):
    """States are left out for it, and the run goes on for the others."""
    idle, talk = page(), page()
    talk.until(lambda t: t.state is not None)
    step = talk.state.step
    assert "error" not in talk.ask("play", rate=200)
    talk.until(lambda t: t.state.step >= step + 60)
    talk.ask("pause")
    idle.until(lambda t: t.state is not None)
    assert idle.frames <= 2


def test_each_edit_is_seen_however_slow_pages_are(page):
    """One page takes nothing, one leaves while states are on their way, and one takes its time: no edit is lost."""
    idle, leaving, slow = page(), page(), page()
    for talk in (leaving, slow):
        talk.until(lambda t: t.state is not None and "scene" in t.told)
    origin, channel = np.array(slow.told["scene"]["origin"]), int(slow.state.channel_id[0])
    assert "error" not in slow.ask("play", rate=240)
    for k in range(12):
        if k == 4:
            leaving.close()
        place = slow.state.point_xy[20 + k] + origin
        edit = {"edit": "MovePoint", "channel": channel, "at": place.tolist(), "to": (place + 5.0).tolist()}
        answer = slow.ask("edit", edit=edit | {"radius": 300.0})
        assert "error" not in answer
        slow.until(lambda t, number=answer["command"]: t.state.edits >= number, 20.0)
        time.sleep(0.02)
    slow.ask("pause")
    assert idle.frames == 0
    for _ in range(12):
        slow.ask("undo")


def test_an_earlier_state_comes_while_the_run_plays(page):
    """No later one takes its place on the way."""
    talk = page()
    talk.until(lambda t: t.state is not None and "session" in t.told)
    first = talk.told["session"]["records"][0][0]
    talk.ask("step", count=3)
    talk.ask("play", rate=200)
    for count in range(1, 6):
        assert "error" not in talk.ask("record", index=0)
        talk.until(lambda t, count=count: len(t.earlier) == count)
        talk.until(lambda t, step=talk.state.step: t.state.step > step)
    assert {state.step for state in talk.earlier} == {first}
    talk.ask("pause")


def test_a_saved_session_has_the_same_bits(page):
    talk = page()
    talk.until(lambda t: t.state is not None and "scene" in t.told)
    origin, step = np.array(talk.told["scene"]["origin"]), talk.state.step
    place, channel = talk.state.point_xy[30] + origin, int(talk.state.channel_id[0])
    edit = {"edit": "MovePoint", "channel": channel, "at": place.tolist(), "to": (place + 50).tolist(), "radius": 400.0}
    assert "error" not in talk.ask("edit", edit=edit)
    talk.ask("step", count=20)
    name = talk.ask("save")["saved"]
    talk.ask("step", count=5)
    talk.until(lambda t: t.state.step == step + 25)
    live = talk.state
    assert "error" not in talk.ask("open_saved", saved=name)
    talk.until(lambda t: t.state.step == step + 20)
    talk.ask("step", count=5)
    talk.until(lambda t: t.state.step == step + 25)
    assert talk.state.point_xy.tobytes() == live.point_xy.tobytes()


def ours(served):
    return {"Cookie": cookie(served), "Origin": f"http://127.0.0.1:{served.port}"}


def test_a_session_as_one_file_restores_the_same_bits(served, page):
    talk = page()
    talk.until(lambda t: t.state is not None and "scene" in t.told)
    origin, step = np.array(talk.told["scene"]["origin"]), talk.state.step
    place, channel = talk.state.point_xy[30] + origin, int(talk.state.channel_id[0])
    edit = {"edit": "MovePoint", "channel": channel, "at": place.tolist(), "to": (place - 40).tolist(), "radius": 400.0}
    assert "error" not in talk.ask("edit", edit=edit)
    talk.ask("step", count=10)
    assert talk.ask("export", name="session.zip")["file"] == "session.zip"
    status, _, archive = get(served, "/exports/session.zip", Cookie=cookie(served))
    assert status == 200
    talk.ask("step", count=7)
    talk.until(lambda t: t.state.step == step + 17)
    live = talk.state
    talk.ask("rewind", step=step)
    assert get(served, "/open/session.zip", "PUT", archive, **ours(served))[0] == 200
    talk.until(lambda t: t.state.step == step + 10)
    talk.ask("step", count=7)
    talk.until(lambda t: t.state.step == step + 17)
    assert talk.state.point_xy.tobytes() == live.point_xy.tobytes()
    assert talk.told["session"]["undo"] >= 1


@pytest.mark.parametrize(
    ("names", "words"),
    [(["../run/x"], "no session"), (["run/../../x"], "no session"), (["/etc/x"], "no session"),
     (["edits.log"], "no run"), (["run/header.json", "a"], "no session"), (["run/run.json"], ""), ([], "no run")],
)  # fmt: skip
def test_archives_that_are_no_session_are_refused(tmp_path, names, words):
    path = tmp_path / "s.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, b"{}")
    with pytest.raises(wr.WarpriverError, match=words):
        unpack_session(path, tmp_path / "there" / "s")
    assert not (tmp_path / "there" / "x").exists() and not (tmp_path / "x").exists()
    path.write_bytes(b"PK\3\4 no archive")
    with pytest.raises(wr.WarpriverError, match="no session"):
        unpack_session(path, tmp_path / "there" / "s")


def test_the_ground_of_an_archive_is_its_own(tmp_path):
    """A run that names a file of this machine as its ground does not bring it in."""
    secret = tmp_path / "secret.npz"
    terrain = wr.generate.tilted_plain((40, 90), 100.0, 1e-3)
    wr.write_terrain(terrain, secret)
    line = wr.generate.noisy_line(6000, 50, 40, 0) + [1000.0, 2000.0]
    network = wr.RiverNetwork.from_polylines([line], width=60.0)
    begin_folder(tmp_path / "s", wr.Simulation(network, terrain=wr.read_terrain(secret)))
    with zipfile.ZipFile(tmp_path / "s.zip", "w") as archive:
        for file in (tmp_path / "s" / "run").iterdir():
            archive.write(file, f"run/{file.name}")
    with pytest.raises(wr.WarpriverError, match="its terrain is missing"):
        unpack_session(tmp_path / "s.zip", tmp_path / "there")


def test_a_bad_recipe_is_told(served):
    for recipe, words in (
        ({"generator": "moon"}, "one of basin"),
        ({"generator": "plain", "width": 1e9}, "give 5 to 500"),
        ({"generator": "plain", "seed": 0.5}, "whole number"),
        ({"generator": "plain", "colour": 1}, "it has no 'colour'"),
        ({"generator": "valley", "example": "S9"}, "S1, S2"),
        ([], "needs the key"),
    ):
        with pytest.raises(wr.WarpriverError, match=words):
            generated(recipe)
    status, _, told = get(served, "/new", "POST", b"[" * 9000, **ours(served))
    assert status == 422 and b"recipe" in told
    assert get(served, "/new", "POST", b"x" * 20_000, **ours(served))[0] == 413
    assert get(served, "/new", "POST", b"{}", Cookie=cookie(served), Origin="http://evil.example")[0] == 403


def test_maps_come_while_the_run_plays(page):
    talk = page()
    talk.until(lambda t: t.state is not None)
    talk.ask("play", rate=100)
    step = talk.state.step
    assert "error" not in talk.ask("map", name="age")
    assert "error" not in talk.ask("types", on=True)
    talk.until(lambda t: t.maps and "river_types" in t.told)
    assert talk.state.step > step, "the run goes on"
    assert talk.told["map"]["title"] == "Years since the channel left" and talk.maps[0][0] == "age"
    assert set(talk.told["river_types"]["types"]) <= set(map(str, talk.state.channel_id.astype(int).tolist()))
    count = len(talk.maps)
    talk.until(lambda t: len(t.maps) > count)
    talk.ask("map", name=None)
    talk.ask("types", on=False)
    talk.ask("pause")
    assert "there is no map 'x'" in talk.ask("map", name="x")["error"]


def test_a_landscape_is_written_and_the_process_of_maps_may_die(served, page):
    pytest.importorskip("PIL", reason="height maps need warpriver[gis]")
    talk = page()
    talk.until(lambda t: t.state is not None)
    assert talk.ask("export", name="landscape-unity.zip")["file"] == "landscape-unity.zip"
    with zipfile.ZipFile(served.folder / "exports" / "landscape-unity.zip") as archive:
        assert any(name.endswith(".r16") for name in archive.namelist())
    number = next(talk.numbers)
    talk.socket.send(json.dumps({"number": number, "do": "export", "name": "run.gif"}))
    os.kill(process_of(served, "wr-maps"), signal.SIGKILL)
    talk.until(lambda t: t.told.get("answer", {}).get("number") == number)
    assert "given up" in talk.told["answer"]["error"]
    assert "error" not in talk.ask("step")


def test_nothing_holds_the_socket_up_while_a_session_is_exchanged(served, page):
    """The old process is in the midst of long work, and has to be killed."""
    talk = page()
    talk.until(lambda t: t.state is not None)
    name = talk.ask("save")["saved"]
    for rest in ({"do": "step", "count": 10_000}, {"do": "open_saved", "saved": name}):
        talk.socket.send(json.dumps({"number": next(talk.numbers), **rest}))
    slowest, until = 0.0, time.monotonic() + 3.0
    while time.monotonic() < until:
        begin = time.monotonic()
        assert get(served, "/static/icon.svg", Cookie=cookie(served))[0] == 200
        slowest = max(slowest, time.monotonic() - begin)
    assert slowest < 1.0, "ending the process takes two seconds"
    talk.until(lambda t: t.told.get("answer", {}).get("saved") == name)
    assert "error" not in talk.ask("step")


def test_a_process_that_dies_is_told_and_the_session_goes_on(served, page):
    talk = page()
    talk.until(lambda t: t.state is not None)
    step = talk.state.step
    talk.ask("step", count=5)
    talk.until(lambda t: t.state.step == step + 5)
    os.kill(process_of(served, "wr-simulation"), signal.SIGKILL)
    talk.until(lambda t: "crashed" in t.told)
    assert "does not run" in talk.ask("step")["error"]
    assert "error" not in talk.ask("restart")
    talk.told.clear()
    talk.until(lambda t: "session" in t.told)
    assert "error" not in talk.ask("step")
    # All edits are there; of the steps those since the last edit, or the last two seconds of playing, are lost.
    talk.until(lambda t: t.state.step <= step + 6)


def process_of(served, name):
    """Number of a process of the session: "wr-simulation", or "wr-maps"."""
    for pid in descendants(served.process.pid):
        with contextlib.suppress(OSError):
            if Path(f"/proc/{pid}/comm").read_text().strip() == name:
                return pid
    raise AssertionError(f"there is no process {name}")


def descendants(root):
    parents = {}
    for name in filter(str.isdigit, os.listdir("/proc")):
        with contextlib.suppress(OSError):
            parents[int(name)] = int(Path(f"/proc/{name}/stat").read_text().rpartition(")")[2].split()[1])
    found = {root}
    for _ in range(4):
        found |= {pid for pid, parent in parents.items() if parent in found}
    return found
