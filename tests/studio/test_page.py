"""The page in a headless Chromium: tools are used by pointer and keys; what the session holds and the pixels tell."""

import base64
import json
import os
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from browser import CHROMIUM
from conftest import send

import warpriver as wr
from warpriver import edits
from warpriver.studio.journal import read_journal, session_of
from warpriver.studio.opening import unpack_session

pytest.importorskip("PIL", reason="looking at the page needs pillow")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: apt-get install chromium")

# The point of the longest channel at a fraction of it, as (x, y) of the page, and the identity of the channel.
PLACE = """(part => { const s = studio.state; let c = 0;
for (let k = 0; k < s.channels; k++) if (s.start[k + 1] - s.start[k] > s.start[c + 1] - s.start[c]) c = k;
const i = Math.round(s.start[c] + part * (s.start[c + 1] - 1 - s.start[c]));
studio.view.update(); const p = studio.view.project(s.xy[2 * i], s.xy[2 * i + 1]);
const box = document.getElementById("view3d").getBoundingClientRect();
return [p[0] + box.left, p[1] + box.top, s.id[c]]; })"""
AXE = """axe.run().then((found) => found.violations.filter((v) => ["serious", "critical"].includes(v.impact))
.map((v) => [v.id, v.nodes.map((n) => n.html.slice(0, 100))]))"""
WATER = np.array([23, 102, 178])  # of rivers, on a screen


@pytest.fixture(scope="module")
def browser(chromium, served):
    """The page of the session, open and drawn."""
    chromium.console.clear()
    chromium.open(served.link)
    chromium.wait("window.studio?.state && studio.scene.frames > 1", 90)
    yield chromium
    assert chromium.console == []
    chromium.open("about:blank")


def said(served):
    """Edits that the session's folder holds."""
    return [entry.edit for entry in read_journal(served.folder / "edits.log")[0]]


def pixels(browser, colour=WATER, within=40):
    """Number of pixels of the map of a colour."""
    seen = browser.screenshot()[50:670, 190:1010].astype(int)
    return int((np.abs(seen - colour).max(axis=2) < within).sum())


def use(browser, tool):
    browser.press(f"[data-tool={tool}]")
    assert browser.run(f"studio.tool.id === {json.dumps(tool)}")


@pytest.fixture
def built_in(studio, chromium):
    """The studio as it begins without a file, and its page; before other tests have put another session there."""
    chromium.open(studio.link)
    chromium.wait("window.studio?.state && studio.scene.frames > 1", 120)
    if chromium.run("!studio.ground.height || studio.live.step > 0 || studio.undo > 0"):
        status, told = send(studio, "POST", "/new", b'{"generator": "basin"}')
        assert status == 200, told
        chromium.wait("studio.live.step === 0 && studio.ground.height", 60)
    yield chromium, studio
    assert chromium.console == []


def test_the_built_in_scene_is_shaped_from_beginning_to_end(built_in, tmp_path):
    """All that an author does in an hour, each step told by what the session holds and by the pixels."""
    browser, served = built_in

    def changed(before, box=(110, 590, 190, 1010)):  # without words at its edges
        browser.wait("!studio.scene.dirty")
        top, bottom, left, right = box
        last.append(browser.screenshot().astype(int))
        differs = np.abs(last[-1][top:bottom, left:right] - before[top:bottom, left:right]).max(axis=2) > 25
        return int(differs.sum())

    last = [browser.screenshot().astype(int)]

    def shot():
        """The picture after one thing is the one before the next."""
        return last[-1]

    assert browser.run("studio.ground.height && studio.live.channels > 10")
    seen = shot()
    browser.run("studio.ask('rate', { rate: 120 })")
    browser.key(" ", "Space")
    browser.wait("studio.live.time >= 50", 120)
    browser.key(" ", "Space")
    browser.wait("!studio.playing && !studio.live.playing")
    assert changed(seen) > 300, "the rivers have moved"

    seen = shot()
    x, y, channel = browser.run(PLACE + "(.6)")
    use(browser, "drag")
    browser.drag(x, y, x + 4, y - 30)
    browser.wait("studio.undo === 1")
    (edit,) = said(served)
    assert isinstance(edit, edits.MovePoint) and edit.channel == channel
    assert changed(seen) > 30

    seen = shot()
    use(browser, "repel")
    browser.drag(520, 420, 600, 430)
    browser.wait("studio.edits.some(([, name]) => name === 'PaintControl')")
    assert any(isinstance(edit, edits.PaintControl) and min(edit.values) < 0.0 for edit in said(served))
    assert changed(seen, (390, 460, 490, 640)) > 200

    seen = shot()
    use(browser, "ridge")
    for k, (a, b) in enumerate(((300, 420), (420, 440)), 1):
        browser.click(a, b)
        browser.wait(f"studio.tool.points.length === {k}")
    browser.key("Enter")
    browser.wait("studio.edits.at(-1)[1] === 'EditTerrain'")
    assert said(served)[-1].operation == "ridge"
    assert changed(seen, (400, 470, 290, 440)) > 200

    seen, count = shot(), browser.run("studio.live.channels")
    use(browser, "draw")
    for k, (dx, dy) in enumerate(((-60, 90), (-30, 50), (0, 0)), 1):
        browser.click(x + 40 + dx, y + 60 + dy) if k < 3 else browser.click(*browser.run(PLACE + "(.7)")[:2])
        browser.wait(f"studio.tool.points.length === {k}")
    browser.key("Enter")
    browser.wait(f"studio.live.channels > {count}")
    assert isinstance(said(served)[-1], edits.AddChannel)
    assert changed(seen) > 60

    with_it, held = shot(), said(served)
    browser.press("#undo")
    browser.wait(f"studio.live.channels === {count}")
    assert said(served) == held[:-1] and changed(with_it) > 60
    browser.press("#redo")
    browser.wait(f"studio.live.channels > {count}")
    assert said(served) == held and changed(with_it) < 30

    browser.run("(t => { t.value = 1; t.dispatchEvent(new Event('input')); })(document.getElementById('timeline'))")
    browser.wait("studio.state.step === studio.records[1][0] && studio.state !== studio.live")
    assert changed(with_it) > 300, "an earlier state is shown"
    browser.run("(t => { t.value = t.max; t.dispatchEvent(new Event('input')); })(document.getElementById('timeline'))")
    browser.wait("studio.shown === null && studio.state === studio.live")

    browser.run("studio.ask('export', { name: 'terrain.png' })")
    assert (served.folder / "exports" / "terrain.png").stat().st_size > 10_000
    browser.run("studio.ask('export', { name: 'session.zip' })")
    unpack_session(served.folder / "exports" / "session.zip", tmp_path / "again")
    # The same bits from the file: the session is done again from its beginning, in another process and without a page.
    again = wr.Simulation.replay(
        tmp_path / "again" / "run", session_of(*read_journal(tmp_path / "again" / "edits.log")[:3]),
        terrain=wr.read_terrain(tmp_path / "again" / "terrain.npz"),
    )  # fmt: skip
    live = np.array(browser.run("Array.from(studio.live.xy)"), np.float32).reshape(-1, 2)
    origin = np.array(browser.run("[...studio.origin]"))
    assert (again.network.points() - origin).astype(np.float32).tobytes() == live.tobytes()


def test_the_map_is_drawn_by_webgl(browser):
    assert browser.run("studio.scene.renderer.getContext() instanceof WebGL2RenderingContext")
    assert not browser.run("studio.scene.renderer.getContext().isContextLost()")
    seen = browser.screenshot()[50:670, 190:1010]
    assert len(np.unique(seen.reshape(-1, 3), axis=0)) > 20, "the canvas is uniform"
    assert pixels(browser) > 300


def test_playing_moves_the_rivers(browser):
    before = browser.run("Array.from(studio.state.xy.slice(0, 200))")
    browser.key(" ", "Space")
    browser.wait("studio.state.time > 20", 90)
    assert browser.run("document.getElementById('play').getAttribute('aria-pressed')") == "true"
    browser.key(" ", "Space")
    browser.wait("!studio.playing && !studio.state.playing")
    assert np.abs(np.array(browser.run("Array.from(studio.state.xy.slice(0, 200))")) - before).max() > 1.0
    assert browser.run("Number(document.getElementById('years').textContent) > 19")


def test_a_bend_is_dragged_undone_and_redone(browser, served):
    x, y, channel = browser.run(PLACE + "(.5)")
    use(browser, "drag")
    origin = browser.run("[...studio.origin]")
    before = browser.run("Array.from(studio.state.xy)")
    browser.drag(x, y, x + 20, y - 24)
    browser.wait("studio.undo === 1")
    edit = said(served)[-1]
    assert isinstance(edit, edits.MovePoint) and edit.channel == channel
    moved = np.array(edit.to) - np.array(edit.at)
    metres = browser.run("studio.view.metres")
    np.testing.assert_allclose(moved, [20 * metres, 24 * metres], atol=2.0 * metres)
    browser.wait(
        f"studio.state.xy.length !== {len(before)} || studio.state.xy.some((v, k) => v !== {json.dumps(before)}[k])"
    )
    # The river is where it was dragged to.
    at = np.array(browser.run("Array.from(studio.state.xy)")).reshape(-1, 2) + origin
    assert np.hypot(*(at - edit.to).T).min() < 30.0, "points are 50 m apart"
    browser.press("#undo")
    browser.wait("studio.undo === 0 && studio.redo === 1")
    browser.wait(f"studio.state.xy.every((v, k) => v === {json.dumps(before)}[k])")
    browser.key("Z", "KeyZ", 2 + 8)
    browser.wait("studio.undo === 1 && studio.redo === 0")
    assert said(served) == [edit]


def test_a_point_is_locked_and_let_go(browser, served):
    x, y, _ = browser.run(PLACE + "(.35)")
    use(browser, "lock")
    browser.click(x, y)
    browser.wait("studio.locks.length === 1")
    assert isinstance(said(served)[-1], edits.LockPoint)
    browser.click(x, y)
    browser.wait("studio.locks.length === 0")


def test_rivers_are_drawn_and_erased(browser, served):
    use(browser, "draw")
    x, y, _ = browser.run(PLACE + "(.7)")
    count, water = browser.run("studio.state.channels"), pixels(browser)
    for k, (dx, dy) in enumerate(((120, 150), (70, 110), (30, 50), (0, 0)), 1):
        browser.click(x + dx, y + dy)
        browser.wait(f"studio.tool.points.length === {k}")
    browser.key("Enter")
    browser.wait(f"studio.state.channels > {count}")
    added = said(served)[-1]
    assert isinstance(added, edits.AddChannel) and len(added.xy) == 4
    assert pixels(browser) > water + 40
    use(browser, "remove")
    browser.click(x + 70, y + 110)  # a point that the river was drawn through
    browser.wait(f"studio.state.channels === {count}")
    assert isinstance(said(served)[-1], edits.RemoveChannel)


def test_strokes_and_controls(browser, served):
    use(browser, "repel")
    empty = browser.screenshot()[350:600, 300:900].astype(int)
    browser.drag(600, 450, 700, 470)
    browser.wait("studio.edits.some(([, name]) => name === 'PaintControl')")
    browser.wait("studio.scene.uniforms.painted.value")
    painted = said(served)
    assert any(isinstance(edit, edits.PaintControl) and min(edit.values) < 0 for edit in painted)
    assert np.abs(browser.screenshot()[350:600, 300:900].astype(int) - empty).max() > 40
    undo = browser.run("studio.undo")
    browser.press("#undo")
    browser.wait(f"studio.undo < {undo}")
    assert len([e for e in said(served) if isinstance(e, edits.PaintControl)]) == 0, "a stroke is one edit to undo"
    use(browser, "attractor")
    browser.click(500, 500)
    browser.wait("studio.controls.length === 1 && studio.controls[0].kind === 'Attractor'")
    browser.run("document.querySelector('#controls button').click()")
    browser.wait("studio.controls.length === 0")


def test_the_size_of_a_channel_is_read_and_set(browser, served):
    x, y, channel = browser.run(PLACE + "(.5)")
    use(browser, "inspect")
    browser.click(x, y)
    browser.wait("document.querySelector('#channel dl')")
    text = browser.run("document.getElementById('channel').innerText")
    assert "Strahler order" in text and "m³/s" in text
    browser.run(
        "document.querySelector('#channel [name=width]').value = 77; document.querySelector('#channel button').click()"
    )
    browser.wait(f"studio.state.size[4 * studio.state.id.indexOf({channel})] === 77")
    assert said(served)[-1] == edits.SetChannel(channel, width=77.0)


def test_a_refused_edit_is_told(browser):
    browser.run("studio.ask('edit', {edit: {edit: 'RemoveChannel', channel: 12345}}).catch(() => {})")
    browser.wait("!document.getElementById('message').hidden")
    assert "12345" in browser.run("document.getElementById('message').textContent")


def test_a_bend_is_cut_off_by_hand(browser, served):
    browser.run("studio.ask('step', { count: 60 })")
    x, y = browser.run("""(() => { const s = studio.state; let best = [2, 0];
      for (let c = 0; c < s.channels; c++) for (let i = s.start[c] + 30; i + 30 < s.start[c + 1]; i++) {
        const j = i + 18, d = Math.hypot(s.xy[2 * j] - s.xy[2 * i], s.xy[2 * j + 1] - s.xy[2 * i + 1]) / 18;
        if (d < best[0] || best[0] === 2) best = [d, i + 9]; }
      studio.view.update(); const p = studio.view.project(s.xy[2 * best[1]], s.xy[2 * best[1] + 1]);
      const box = document.getElementById("view3d").getBoundingClientRect();
      return [p[0] + box.left, p[1] + box.top]; })()""")
    left = browser.run("studio.scene.oxbows.count")
    use(browser, "cut")
    browser.click(x, y)
    browser.wait(f"studio.scene.oxbows.count > {left}")
    assert isinstance(said(served)[-1], edits.CutLoop)
    browser.press("#undo")
    browser.wait(f"studio.scene.oxbows.count === {left}")


def test_the_timeline_shows_earlier_states_and_goes_on_from_one(browser):
    browser.press("#step")
    browser.wait("studio.records.length > 10")
    browser.run("(t => { t.value = 5; t.dispatchEvent(new Event('input')); })(document.getElementById('timeline'))")
    step = browser.run("studio.records[5][0]")
    browser.wait(f"studio.state.step === {step}")
    browser.press("#rewind")
    browser.wait(f"studio.live.step === {step} && studio.shown === null")


def test_relief_theme_layers_and_keys(browser):
    flat = browser.screenshot()
    browser.key("v", "KeyV")
    browser.wait("studio.view.relief")
    browser.key("v", "KeyV")
    browser.wait("!studio.view.relief")
    browser.run("document.getElementById('layer-rivers').click()")
    browser.wait("!studio.scene.dirty")
    hidden = pixels(browser)
    browser.run("document.getElementById('layer-rivers').click()")
    browser.wait("!studio.scene.dirty")
    assert hidden < 0.2 * pixels(browser)
    browser.key("t", "KeyT")
    browser.wait("!studio.scene.dirty")
    assert browser.screenshot().mean() < 0.7 * flat.mean()
    browser.key("t", "KeyT")
    metres = browser.run("studio.view.metres")
    browser.key("+")
    browser.wait(f"studio.view.metres < {metres}")
    browser.key("Home")


def test_an_export_that_cannot_be_is_told(browser):
    browser.press("[data-export='terrain.tif']")
    browser.wait("document.getElementById('message').textContent.includes('no terrain')")


def test_maps_lie_on_the_ground_with_a_legend(browser):
    browser.press("#step")
    plain = browser.screenshot()[50:670, 190:1010].astype(int)
    browser.run(
        "(m => { m.value = 'moisture'; m.dispatchEvent(new Event('change')); })(document.getElementById('map'))"
    )
    browser.wait("studio.map?.name === 'moisture' && !studio.scene.dirty", 90)
    assert "Soil moisture" in browser.run("document.getElementById('map-legend').innerText")
    covered = browser.screenshot()[50:670, 190:1010].astype(int)
    assert (np.abs(covered - plain).max(axis=2) > 8).mean() > 0.05
    browser.run("(m => { m.value = ''; m.dispatchEvent(new Event('change')); })(document.getElementById('map'))")
    browser.wait("!studio.map && document.getElementById('map-legend').hidden")
    browser.press("#types")
    browser.wait("studio.types", 90)
    assert browser.run("document.querySelectorAll('#types-legend li').length") >= 1
    browser.press("#types")
    browser.wait("!studio.types")


def test_constants_have_symbols_and_presets(browser):
    text = browser.run("document.getElementById('constants').textContent")
    assert "kmigration rate (m/yr)" in text and "Γupstream weight" in text
    titles = browser.run("[...document.querySelectorAll('#constants label')].map((e) => e.title)")
    assert all(len(title) > 20 for title in titles)
    browser.run(
        "(p => { p.value = 'paper'; p.dispatchEvent(new Event('change')); })(document.getElementById('preset'))"
    )
    assert "Table 1" in browser.run("document.getElementById('preset').selectedOptions[0].textContent")
    browser.press("#use-preset")
    browser.wait("Math.abs(document.querySelector('#constants [name=migration_rate]').value - 59.9) < 0.1")
    browser.wait("studio.live.step === 0")  # its state comes after the constants


def make_land(browser, kind, **values):
    """Make land in the dialog."""
    browser.press("#new")
    browser.run(
        "(s => { s.value = " + json.dumps(kind) + "; s.dispatchEvent(new Event('change')); })"
        "(document.querySelector('#fresh select'))"
    )
    browser.run(
        f"Object.entries({json.dumps(values)}).forEach(([k, v]) => {{"
        " const e = document.querySelector(`#fresh [name=${k}]`);"
        " e.value = v; e.dispatchEvent(new Event('input', { bubbles: true })); })"
    )


def test_land_is_made_in_the_dialog(browser, served):
    make_land(browser, "fan", size=4, count=5)
    browser.press("#fresh button[type=submit]")
    browser.wait("studio.live.channels === 5 && studio.ground.height", 120)
    use(browser, "ridge")
    before = browser.run("studio.ground.height.values.reduce((a, v) => a + v, 0)")
    for k, (x, y) in enumerate(((500, 200), (700, 260)), 1):
        browser.click(x, y)
        browser.wait(f"studio.tool.points.length === {k}")
    browser.key("Enter")
    browser.wait(f"studio.ground.height.values.reduce((a, v) => a + v, 0) > {before} + 1000")
    assert isinstance(said(served)[-1], edits.EditTerrain)


def test_land_that_takes_long_tells_so_and_is_given_up(browser):
    make_land(browser, "eroded", cells=300, rain=20)
    assert "seconds" in browser.run("document.getElementById('fresh-takes').textContent")
    points = browser.run("studio.live.points")
    browser.press("#fresh button[type=submit]")
    browser.wait("!document.getElementById('busy').hidden")
    assert "of about" in browser.run("document.getElementById('busy-text').textContent")
    browser.press("#busy-cancel")
    browser.wait("document.getElementById('busy').hidden")
    browser.wait("document.getElementById('message').textContent.startsWith('Given up')")
    browser.run("studio.ask('step')")
    assert browser.run("studio.live.points") == pytest.approx(points, rel=0.2), "the session goes on as it was"


DROP = """((name, data) => {
  const carried = new DataTransfer(), bytes = Uint8Array.from(atob(data), (c) => c.charCodeAt(0));
  carried.items.add(new File([bytes], name));
  const how = { dataTransfer: carried, bubbles: true, cancelable: true }, map = document.getElementById("view3d");
  for (const kind of ["dragenter", "dragover", "drop"]) map.dispatchEvent(new DragEvent(kind, how));
})"""


def drop(browser, path):
    """Drop a file on the map."""
    given = (path.name, base64.b64encode(path.read_bytes()).decode())
    browser.run(f"{DROP}(...{json.dumps(given)})")


def test_files_are_dropped_on_the_map(browser, lines_file, tmp_path):
    terrain = wr.generate.fluvial_terrain((60, 70), 50.0, 300.0, 1)
    wr.write_terrain(terrain, tmp_path / "hills.asc")
    drop(browser, tmp_path / "hills.asc")
    browser.wait("studio.ground.height?.columns === 70 && studio.live.channels > 1")
    heights = np.array(browser.run("Array.from(studio.ground.height.values.slice(0, 70))"))
    np.testing.assert_allclose(heights, terrain.to_numpy()[0], atol=0.01, err_msg="of the file, with 2 decimals")
    (tmp_path / "valley.toml").write_text(SCENE)
    drop(browser, tmp_path / "valley.toml")
    browser.wait("studio.live.channels === 1 && studio.ground.height.columns === 40")
    (tmp_path / "broken.csv").write_text("x,y\n1,nonsense\n")
    drop(browser, tmp_path / "broken.csv")
    browser.wait("document.getElementById('message').textContent.startsWith('broken.csv')")
    assert browser.run("studio.live.channels") == 1, "the session stays"
    assert len([line for line in browser.console if "422" in line]) == len(browser.console) == 1
    browser.console.clear()
    drop(browser, lines_file)
    browser.wait("studio.live.channels === 3 && !studio.ground.height")
    assert browser.run("document.getElementById('drop').hidden")


SCENE = """name = "valley"
[terrain]
generate = "tilted_plain"
shape = [30, 40]
cell_size = 50.0
slope = 0.001

[[network.channel]]
points = [[100.0, 700.0], [700.0, 760.0], [1300.0, 700.0], [1900.0, 760.0]]
width = 30.0

[run]
years = 10.0
"""


@pytest.fixture(scope="module")
def small(browser):
    """A small plain with a river that has gone 12 steps, on the page."""
    make_land(browser, "plain", length=2, cell=20, width=40, wandering=3)
    browser.press("#fresh button[type=submit]")
    browser.wait("studio.live.channels === 1 && studio.ground.height?.columns === 100", 60)
    browser.run("(async () => { for (let k = 0; k < 12; k++) await studio.ask('step'); })()")
    return browser


@pytest.fixture
def downloads(small, served, tmp_path):
    """Waits until the page downloads a file, and returns the file as the server gives it out."""
    small.run("studio.files.length = 0; document.getElementById('message').hidden = true")

    def get(name):
        small.wait(f"studio.files.includes('{name}') || !document.getElementById('message').hidden", 60)
        assert small.run(f"studio.files.includes('{name}')"), small.run(
            "document.getElementById('message').textContent"
        )
        status, data = send(served, "GET", f"/exports/{name}", None)
        assert status == 200
        (tmp_path / name).write_bytes(data)
        return tmp_path / name

    return get


def test_all_that_is_exported_opens_again(small, downloads, tmp_path):
    pytest.importorskip("pyogrio", reason="a GeoPackage needs warpriver[gis]")
    pytest.importorskip("rasterio", reason="a GeoTIFF needs warpriver[gis]")
    from PIL import Image

    points, height = small.run("studio.live.points"), np.array(small.run("Array.from(studio.ground.height.values)"))
    for button in small.run("[...document.querySelectorAll('[data-export]')].map((e) => e.dataset.export)"):
        small.press(f"[data-export='{button}']")
    for name in ("rivers.gpkg", "rivers.geojson"):
        assert wr.read_network(downloads(name)).point_count == points
    np.testing.assert_allclose(wr.read_terrain(downloads("terrain.tif")).to_numpy().ravel(), height, atol=1e-4)
    assert Image.open(downloads("terrain.png")).size == (100, 50)
    assert json.loads(downloads("edits.json").read_text())
    unpack_session(downloads("session.zip"), tmp_path / "again")
    with Image.open(downloads("run.gif")) as movie:
        assert movie.n_frames > 10 and movie.size == (1280, 720)
    assert b"ftyp" in downloads("run.mp4").read_bytes()[:12]
    small.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path / "browser"))
    small.press("#picture")
    until = time.monotonic() + 30.0
    while not (tmp_path / "browser" / "rivers.png").exists() and time.monotonic() < until:
        time.sleep(0.05)
    assert len(np.unique(np.asarray(Image.open(tmp_path / "browser" / "rivers.png").convert("L")))) > 20


def opened(target, name, data):
    """Open a file of a landscape, and tell whether it holds one."""
    import io

    from PIL import Image

    ending = name.rsplit(".", 1)[1]
    if ending == "png":
        return np.ptp(np.asarray(Image.open(io.BytesIO(data)), float)) >= 0.0
    if ending == "r16":
        return np.ptp(np.frombuffer(data, "<u2")) > 1000
    if ending == "json":
        return bool(json.loads(data))
    if ending == "glb":
        return data[:4] == b"glTF" and int.from_bytes(data[8:12], "little") == len(data)
    if ending in ("vtp", "pvd"):
        return b"<VTKFile" in data[:100] and data.rstrip().endswith(b"</VTKFile>")
    if ending == "usda":
        return data.startswith(b"#usda") and data.count(b"{") == data.count(b"}")
    if ending == "obj":
        return sum(line.startswith(b"f ") for line in data.splitlines()) > 1000
    return len(data) > 20


def test_landscapes_are_written_for_every_program(small, downloads):
    pytest.importorskip("rasterio", reason="a landscape for a GIS needs warpriver[gis]")
    targets = small.run("[...document.getElementById('target').options].map((o) => o.value)")
    assert len(targets) == 8
    for target in targets:
        small.run(f"document.getElementById('target').value = '{target}'")
        small.press("#landscape")
    for target in targets:
        with zipfile.ZipFile(downloads(target)) as archive:
            names = archive.namelist()
            assert len(names) >= 3 and archive.testzip() is None, target
            assert all(opened(target, name, archive.read(name)) for name in names), target
            assert {name.split("/")[0] for name in names} == {target[len("landscape-") : -len(".zip")]}


def test_plots_are_full_after_a_reload(small, served):
    small.run("studio.ask('step', { count: 120 })")
    small.wait("studio.plots.series.sinuosity.length > 2")
    before = small.run("studio.plots.series.sinuosity")
    small.open(served.link)
    small.wait("window.studio?.state && studio.plots.series.sinuosity.length > 2")
    after = small.run("studio.plots.series.sinuosity")
    assert after[0] == before[0] and after[-1] == before[-1]
    drawn = small.run("""(() => { const c = document.querySelector("#plots canvas");
      const image = c.getContext("2d").getImageData(0, 0, c.width, c.height);
      return image.data.filter((v, k) => k % 4 === 3 && v).length; })()""")
    assert drawn > 300, "a line across the plot"


def test_two_fingers_move_and_zoom_on_a_tablet(browser):
    browser.call("Emulation.setDeviceMetricsOverride", width=1024, height=768, deviceScaleFactor=1, mobile=True)
    browser.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
    browser.wait("studio.view.width < 700")
    metres, at = browser.run("studio.view.metres"), browser.run("[studio.view.x, studio.view.y]")

    def touch(kind, *points):
        given = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(points)]
        browser.call("Input.dispatchTouchEvent", type=kind, touchPoints=given)

    touch("touchStart", (400, 300), (500, 300))
    for k in range(1, 6):
        touch("touchMove", (400 - 10 * k, 300 + 8 * k), (500 + 10 * k, 300 + 8 * k))
    touch("touchEnd")
    # Twice as far apart: half as many metres a pixel.
    assert browser.run("studio.view.metres") == pytest.approx(0.5 * metres, rel=0.02)
    assert browser.run("studio.view.y") > at[1]
    overflow = (
        "document.documentElement.scrollWidth > innerWidth || document.documentElement.scrollHeight > innerHeight"
    )
    assert not browser.run(overflow)
    small = browser.run("""[...document.querySelectorAll("header button, nav button, footer button")]
      .filter((e) => e.getBoundingClientRect().height < 40).length""")
    assert small == 0
    browser.call("Emulation.setTouchEmulationEnabled", enabled=False)
    browser.call("Emulation.setDeviceMetricsOverride", width=1280, height=720, deviceScaleFactor=1, mobile=False)
    browser.wait("studio.view.width > 700")
    assert not browser.run(overflow)


def test_everything_has_a_name_and_a_tooltip(browser):
    bare = browser.run("""[...document.querySelectorAll("button, input, select, a[href]")].filter((e) => {
      const label = e.getAttribute("aria-label") || e.textContent.trim() || e.labels?.[0]?.textContent.trim();
      const tip = e.title || e.closest("[title]")?.title || e.type === "file";
      return !label || !tip; }).map((e) => e.outerHTML.slice(0, 120))""")
    assert bare == []


def test_axe_finds_no_serious_fault(browser):
    path = os.environ.get("AXE_JS")
    if not path:
        pytest.skip("AXE_JS is not set: the path of axe.min.js, from npm's axe-core")
    browser.run(Path(path).read_text() + ";0")
    for theme in ("light", "dark"):
        browser.run(f"document.documentElement.dataset.theme = '{theme}'")
        browser.run("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
        assert browser.run(AXE) == []
    browser.run("document.documentElement.dataset.theme = 'auto'")
