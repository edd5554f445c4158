"""What the documents say can be done: links lead somewhere, examples run as they stand, commands and targets exist."""

import re
import shlex
import textwrap
from pathlib import Path

import pytest

from warpriver import Terrain, __version__, generate
from warpriver.cli import _parser, main
from warpriver.io import write_terrain

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    page
    for pattern in ("*.md", "docs/**/*.md", "demos/*.md", "benchmarks/*.md", "kernels/*.md", ".github/**/*.md")
    for page in ROOT.glob(pattern)
)
# Where a block of code begins and ends, with the name of its language; such a block may stand in a list.
FENCE = re.compile(r"^ *```(\w*)\n(.*?)^ *```$", re.M | re.S)


def name_of(page):
    return page.relative_to(ROOT).as_posix()


def blocks(page, language):
    """The fenced blocks of a page in one language, in order."""
    return [textwrap.dedent(code) for kind, code in FENCE.findall(page.read_text()) if kind == language]


def shell_lines(page):
    """The lines that a page tells its reader to type, without comments: in fenced blocks or indented ones."""
    indented = re.findall(r"^ {4}(\S.*)$", FENCE.sub("", page.read_text()), re.M)
    typed = [line for code in blocks(page, "bash") for line in code.splitlines()] + indented
    return [words for line in typed if (words := shlex.split(line.removeprefix("$ "), comments=True))]


def commands(page):
    """The arguments of each line that calls warpriver."""
    return [words[1:] for words in shell_lines(page) if words[0] in ("warpriver", ".venv/bin/warpriver")]


def anchors(page):
    """Names of a page's headings, as GitHub makes them."""
    titles = re.findall(r"^#+ (.*)$", FENCE.sub("", page.read_text()), re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def run_blocks(page):
    """Run all Python of a page in one namespace; a failure names the page and the line of its block."""
    namespace = {"__name__": "__main__"}
    for number, code in enumerate(blocks(page, "python"), start=1):
        exec(compile(code, f"{name_of(page)}, Python block {number}", "exec"), namespace)
    return namespace


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", page.read_text())):
        if re.match(r"[a-z]+:", target):
            continue
        place, _, anchor = target.partition("#")
        found = (page.parent / place).resolve() if place else page
        assert found.exists(), f"{name_of(page)} links to {target}, which is not there"
        assert found.is_relative_to(ROOT), f"{name_of(page)} links to {target}, outside the repository"
        if anchor:
            assert anchor in anchors(found), f"{name_of(page)} links to {target}; headings: {sorted(anchors(found))}"


def test_the_readme_leads_to_every_page():
    linked = {(ROOT / target).resolve() for target in re.findall(r"\]\(([^):\s]+)\)", (ROOT / "README.md").read_text())}
    pages = {page for page in PAGES if ".github" not in page.parts} - {ROOT / "README.md", ROOT / "docs" / "README.md"}
    assert pages <= linked, [name_of(page) for page in pages - linked]


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)], ids=name_of)
def test_commands_parse(page):
    for arguments in commands(page):
        try:
            _parser().parse_args(arguments)
        except SystemExit as stop:
            assert stop.code == 0, f"{name_of(page)}: warpriver {shlex.join(arguments)}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_make_targets_exist(page):
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.M))
    named = [words[1:] for words in shell_lines(page) if words[0] == "make"]
    named += [words.split() for words in re.findall(r"`make ([^`]+)`", page.read_text())]
    used = {word for words in named for word in words if "=" not in word}
    assert used <= targets, used - targets


@pytest.mark.filterwarnings("error::UserWarning", "error::RuntimeWarning")
@pytest.mark.usefixtures("coarse_pictures")
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")], ids=name_of)
def test_python_examples_run_in_order(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for scene in blocks(page, "toml"):  # which the page then runs
        Path("scene.toml").write_text(scene)
    run_blocks(page)


@pytest.mark.usefixtures("coarse_pictures")
def test_the_readmes_commands_run_in_order(tmp_path, monkeypatch, capsys):
    """On what ``make demo`` leaves behind, with a coarser and smaller terrain."""
    monkeypatch.chdir(tmp_path)
    Path("out/demo").mkdir(parents=True)
    basin = generate.intermontane_basin(cell_size=400.0, seed=1)
    write_terrain(Terrain(basin.to_numpy()[: basin.shape[0] // 2], basin.cell_size), "out/demo/terrain.npz")
    ran = [arguments for arguments in commands(ROOT / "README.md") if arguments[0] in ("network", "simulate", "render")]
    assert len(ran) > 3
    for arguments in ran:
        assert main(arguments) == 0, (arguments, capsys.readouterr().err)
    for result in ("rivers.gpkg", "rivers.png", "out/rivers/run/run.json", "out/rivers/belt.png", "belt.gif"):
        assert Path(result).stat().st_size > 0, result


def test_the_readme_starts_with_two_commands_and_is_short():
    readme = ROOT / "README.md"
    made = [words for words in shell_lines(readme) if words[0] == "make"]
    assert made == [["make", "demo"], ["make", "test"]]
    assert len(readme.read_text().splitlines()) <= 160


def test_the_citation_has_the_version():
    citation = (ROOT / "CITATION.cff").read_text()
    stated = re.findall(r'^version = "(.*)"$', (ROOT / "pyproject.toml").read_text(), re.M)
    assert re.findall(r"^version: (.*)$", citation, re.M) == stated == [__version__]
    assert re.findall(r"^cff-version: (.*)$", citation, re.M) == ["1.2.0"]
    assert re.findall(r"^license: (.*)$", citation, re.M) == ["Apache-2.0"]


def test_hooks_are_local():
    """They have to work without a network, and with the versions that ``make lint`` uses."""
    hooks = (ROOT / ".pre-commit-config.yaml").read_text()
    assert re.findall(r"repo: (.*)$", hooks, re.M) == ["local"]
    entries = re.findall(r"entry: (.*)$", hooks, re.M)
    assert len(entries) == 3 and all(entry.startswith(".venv/bin/") for entry in entries)
