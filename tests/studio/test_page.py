"""The page in a headless Chromium: tools are used by pointer and keys; what the session holds and the pixels tell."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from browser import CHROMIUM, Browser

import warpriver as wr
from warpriver import edits
from warpriver.studio.journal import read_journal

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
def browser(served):
    """The page of the session, open and drawn."""
    browser = Browser()
    browser.open(served.link)
    browser.wait("window.studio?.state && studio.scene.frames > 1", 90)
    yield browser
    assert browser.console == []
    browser.close()


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


def test_exports_are_files_that_read_back(browser, served):
    pytest.importorskip("pyogrio", reason="a GeoPackage needs warpriver[gis]")
    browser.run("studio.ask('export', {name: 'rivers.gpkg'})")
    network = wr.read_network(served.folder / "exports" / "rivers.gpkg")
    assert network.channel_count == browser.run("studio.live.channels")
    assert "no terrain" in browser.run("studio.link.ask('export', {name: 'terrain.tif'}).catch((e) => e.message)")


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
